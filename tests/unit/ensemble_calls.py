"""Functions that the workers of the ensemble tests import."""

import os

import numpy as np
from fretflow.core.errors import NonConvergenceError


class Stubborn(Exception):
    """An error that cannot travel between processes."""

    def __reduce__(self):
        raise TypeError("stays at home")


def raise_history(history):
    raise NonConvergenceError("no step helps", history=history)


def raise_stubborn(text):
    raise Stubborn(text)


def blas_threads(variable):
    np.ones((2, 2)) @ np.ones((2, 2))
    return os.environ.get(variable)


def chatter(text):
    os.write(1, b"noise on stdout")
    return text
