"""FRFs put together: products, sums, inverses, closed loops and closures, each with its covariance.

Signs are those of the picture in `loop.loop`: negative feedback, e = r - y. Products act from right to left,
`product(P, K)` is P K with K first. Closures (linear fractional transformations) add no sign of their own.

Covariances go through to first order: d of vec(A B) is (B^T x I) d vec(A) + (I x A) d vec(B), of vec(A^-1) it is
-(A^-T x A^-1) d vec(A), and the same rule gives feedback and closures (Magnus and Neudecker, Matrix Differential
Calculus, chapter 9). They mislead where an error is not small beside what is inverted, and **operands are taken as
independent**. What uses one measurement twice (P P^-1, S + T) is not: `feedback` and the closures take each operand
once and treat its error right. An FRF with errors that meets itself is refused, one that meets another made of the same
recording gets a note.

Channels are connected by name and reordered where only their order differs; names that differ are refused unless
`connect="order"` says that the k-th goes with the k-th. Lines must be the same to 1e-9: `regrid` is asked for, and
never done in silence. Coherences and powers belong to a measurement and do not go through.
"""

from loopshape.data.algebra.operations import (
    ClosedLoop,
    add,
    channels,
    controller_frf,
    feedback,
    inverse,
    lower_closure,
    product,
    subtract,
    upper_closure,
)
from loopshape.data.algebra.sampling import regrid, with_hold

__all__ = [
    "ClosedLoop",
    "add",
    "channels",
    "controller_frf",
    "feedback",
    "inverse",
    "lower_closure",
    "product",
    "regrid",
    "subtract",
    "upper_closure",
    "with_hold",
]
