"""Compression: the response of a linear rig as coefficients along fixed filters of its inputs.

For a control engineer: after a fit of an excerpt the poles of the rig are known to some per cent.  So
its transfer function is a short series of orthonormal functions with poles near these (Laguerre's, of
several real and complex poles: Takenaka and Malmquist, Kautz), and each of these is a filter that no
unknown changes.  The filters run once over the whole record.  What they make of the inputs are columns
of a matrix, which one QR decomposition turns into a triangle of some fifty numbers a side.  From then on
a rig is some fifty coefficients.  Its sum of squared residuals is that of a triangle times these, with
the part that no filter reaches, as constant: it takes as long for a million samples as for a thousand.
What a series leaves out has a bound, walker by walker; beyond it the exact simulator is asked.

`basis` chooses poles and makes the triangle, `basis_kernel` writes the code that expands a rig,
`sums_kernel` that of sums and normal equations, and `simulator` is the `Simulator` of all that.
`rig.simulators` says which records are compressed; a record compressed for rigs near a maximum is
found by `inference.compression`.
"""
