"""Numbers in sentences for people."""

MOST_DIGITS = 12


def share(value: float, digits: int = 1) -> str:
    """A share as percent; one that is not quite all, or not quite nothing, gets the digits to say so.

    >>> share(0.5), share(0.99996), share(1.0), share(2e-5)
    ('50.0%', '99.996%', '100.0%', '0.002%')
    """
    whole = format(round(value), ".0%")
    while digits < MOST_DIGITS and value != round(value) and float(f"{value:.{digits}%}"[:-1]) == float(whole[:-1]):
        digits += 1
    return f"{value:.{digits}%}"


def counted(number: int, what: str) -> str:
    """How many of what, `what` in the singular.

    >>> counted(1, "iteration"), counted(1200, "sample")
    ('1 iteration', '1,200 samples')
    """
    return f"{number:,} {what}{'' if number == 1 else 's'}"
