"""Compression represents the response of a linear rig by coefficients of fixed input filters.

After a fit of an excerpt the poles of the rig are known to some per cent. So its transfer function
is a short series of orthonormal functions with poles near these. They are Laguerre's functions, for
several real and complex poles those of Takenaka and Malmquist, and of Kautz. Each is a filter that
no unknown parameter changes.

The filters run once over the whole record. Their outputs are columns of a matrix, which a QR
decomposition reduces to a triangle of some fifty rows. From then on a rig is some fifty
coefficients. Its sum of squared residuals is that of the triangle times these, plus a constant. So
it takes as long for a million samples as for a thousand. The truncation of the series has a bound
for each walker; beyond it the exact simulator is used.

`basis` chooses poles and makes the triangle. `basis_kernel` writes the code that expands a rig, and
`sums_kernel` that of sums and normal equations. `simulator` is the resulting `Simulator`.
`rig.simulators` says which records are compressed; `inference.compression` compresses a record for
rigs near a maximum.
"""
