"""Numerical failure as one error: the data do not determine what is asked of them."""

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from tiltcal.core.errors import TiltcalError

NOT_FINITE = (
    "infs or nans",
    "must be finite",
    "must not contain",
    "cannot convert float",
    "is not finite",
)
"""Of the messages by which libraries refuse numbers that are not finite."""


@contextmanager
def determining(subject: str, what: str) -> Iterator[None]:
    """Turn numerical failure into a refusal: ``subject`` does not determine ``what``.

    Raises:
        TiltcalError: a matrix is singular, an iteration does not converge, or a number overflows.
    """
    try:
        yield
    except (np.linalg.LinAlgError, ArithmeticError) as error:
        raise undetermined(subject, what, str(error)) from error
    except ValueError as error:
        if not any(text in str(error).lower() for text in NOT_FINITE):
            raise
        raise undetermined(subject, what, "numbers that are not finite") from error


def undetermined(subject: str, what: str, why: str) -> TiltcalError:
    """The one refusal for numerical failure."""
    return TiltcalError(
        subject,
        found=f"that it does not determine {what} ({why})",
        need="readings in enough different positions, within the range of the sensor",
        do="record more positions, or correct its columns",
    )


@contextmanager
def one_thread() -> Iterator[None]:
    """Linear algebra on one thread: for thousands of small matrices threads cost more time than
    they save.
    """
    import scipy.linalg  # noqa: F401  # threadpoolctl limits loaded libraries only
    from threadpoolctl import threadpool_limits

    with threadpool_limits(1, user_api="blas"):
        yield
