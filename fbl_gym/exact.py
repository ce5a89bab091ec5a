"""Numbers that are the same on every machine; C libraries differ in their last bits."""

from decimal import Context, Decimal

_DIGITS = Context(prec=50)


def exp(x: float) -> float:
    """Return e**x, rounded once."""
    return float(_DIGITS.exp(Decimal(x)))


def log1p(x: float) -> float:
    """Return log(1 + x), rounded once."""
    return float(_DIGITS.ln(_DIGITS.add(1, Decimal(x))))
