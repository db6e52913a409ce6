"""Numbers of twice the precision of float64: unevaluated sums of two, as tuples (high, low).

The functions take float64 numbers, or vectors of them.

References
----------
Joldes, Muller and Popescu, "Tight and Rigorous Error Bounds for Basic Building Blocks of
Double-Word Arithmetic", ACM Transactions on Mathematical Software 44(2), 2017.
"""

from __future__ import annotations

from raystream.jit.cpu import device
from raystream.jit.simd import fma


@device
def two_sum(x, y):
    """The sum of two numbers, rounded, and its rounding error, exactly."""
    total = x + y
    part = total - x
    return total, (x - (total - part)) + (y - part)


@device
def _ordered_sum(x, y):
    """The same where y is not larger than x."""
    total = x + y
    return total, y - (total - x)


@device
def two_product(x, y):
    """The product of two numbers, rounded, and its rounding error, exactly."""
    product = x * y
    return product, fma(x, y, -product)


@device
def difference(x, y):
    """The difference of two numbers, exactly."""
    return two_sum(x, -y)


@device
def negate_double(x):
    """The negative."""
    return -x[0], -x[1]


@device
def add_double(x, y):
    """The sum, with an error of at most 2**-104 of both magnitudes together."""
    high, low = two_sum(x[0], y[0])
    return _ordered_sum(high, low + (x[1] + y[1]))


@device
def multiply_double(x, y):
    """The product, with a relative error of at most 7 * 2**-106."""
    high, low = two_product(x[0], y[0])
    return _ordered_sum(high, low + fma(x[0], y[1], x[1] * y[0]))


@device
def _scale(x, factor):
    """The product with a float64 number, with a relative error of at most 3 * 2**-106."""
    high, low = two_product(x[0], factor)
    return _ordered_sum(high, fma(x[1], factor, low))


@device
def divide_double(x, y):
    """The quotient, with a relative error of at most 2**-100."""
    high = x[0] / y[0]
    product = _scale(y, high)
    rest = add_double(x, negate_double(product))
    return _ordered_sum(high, rest[0] / y[0])


@device
def _cross_component(a, b, c, d):
    """Compute a * b - c * d."""
    return add_double(multiply_double(a, b), negate_double(multiply_double(c, d)))


@device
def cross_double(x, y):
    """The cross product of two triples."""
    return (
        _cross_component(x[1], y[2], x[2], y[1]),
        _cross_component(x[2], y[0], x[0], y[2]),
        _cross_component(x[0], y[1], x[1], y[0]),
    )


@device
def cross_with(x, d):
    """The cross product of a triple with a triple of float64 numbers."""
    return (
        add_double(_scale(x[1], d[2]), negate_double(_scale(x[2], d[1]))),
        add_double(_scale(x[2], d[0]), negate_double(_scale(x[0], d[2]))),
        add_double(_scale(x[0], d[1]), negate_double(_scale(x[1], d[0]))),
    )


@device
def dot_double(x, y):
    """The scalar product of two triples."""
    return add_double(
        add_double(multiply_double(x[0], y[0]), multiply_double(x[1], y[1])),
        multiply_double(x[2], y[2]),
    )


@device
def dot_with(x, d):
    """The scalar product of a triple with a triple of float64 numbers."""
    return add_double(add_double(_scale(x[0], d[0]), _scale(x[1], d[1])), _scale(x[2], d[2]))
