"""Compression represents the response of a linear rig by coefficients of fixed input filters.

After a fit to an excerpt of the record, the poles of the rig are known to some per cent. Its
transfer function is then a short series of orthonormal functions whose poles are near those of the
rig. For one pole these are Laguerre functions, for several real poles Takenaka-Malmquist functions,
and for complex poles Kautz functions. Each is a filter that depends on no unknown parameter.

The filters run once over the whole record. Their outputs are columns of a matrix, which a QR
decomposition reduces to a triangle R of some fifty rows. From then on a rig is given by some fifty
coefficients c, minus those of a reference rig. The sum of squared residuals is |r - R c|^2 plus a
constant, with the projected residuals r of the reference rig. So a million samples take no longer
than a thousand. The truncation error has a bound for each walker (set of parameters). If this bound is
too large, the exact simulator is used.

`basis` chooses poles and computes the triangle. `basis_kernel` writes the code that expands a rig,
and `sums_kernel` that of sums and normal equations. `simulator` has the resulting `Simulator`.
`rig.simulators` says which records can be compressed; `inference.compression` compresses a record
for rigs near a maximum.
"""
