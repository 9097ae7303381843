"""Arguments of public functions and records: what is of another type than annotated is refused in one line.

Annotations are the one place that says what an argument may be; what they name for type checkers alone is not checked.
Ranges and shapes are checked by what the arguments are for.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from functools import cache, partial, wraps
from math import isfinite
from numbers import Complex, Integral, Real
from types import FunctionType, NoneType, UnionType
from typing import Annotated, Any, Literal, NamedTuple, TypeVar, Union, get_args, get_origin

import numpy as np

from fretflow.core.errors import FretflowError, InputError

F = TypeVar("F", bound=Callable[..., Any])
MOST_SHOWN = 60  # characters of a wrong value


class Like(NamedTuple):
    """What values of an annotation are, in words, and whether one is of them; an annotation may carry its own."""

    words: str
    test: Callable[[Any], bool]


def checked(public: F) -> F:
    """Return a public function that refuses arguments of another type than annotated; a class is changed in place.

    NaN and infinity are no numbers, and arrays have one or two dimensions. Of a class the making of objects is checked,
    by itself and by its class methods, afterwards: what these say of an argument themselves goes first, and which
    values they take is theirs to say.
    """
    if not inspect.isclass(public):
        made: F = _checked(public, public.__qualname__, last=False)
        return made
    setattr(public, "__init__", _checked(public.__init__, public.__qualname__, last=True))  # noqa: B010 - for mypy
    for name, made in list(vars(public).items()):
        if isinstance(made, classmethod) and not name.startswith("_"):
            setattr(public, name, classmethod(_checked(made.__func__, made.__func__.__qualname__, last=True)))
    return public


def _checked(function: Any, name: str, last: bool) -> Any:
    """Return a function whose arguments are checked before it runs, or `last`, where it did not refuse them itself."""
    signature = inspect.signature(function)

    def refuse_wrong(args: Any, kwargs: Any, strict: bool) -> None:
        for key, value in signature.bind(*args, **kwargs).arguments.items():
            due = _due(function, key, strict)
            if value is not signature.parameters[key].default and not due.test(value):
                raise InputError(f"{name}: {key} must be {due.words}, got {_shown(value)}")

    @wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        try:
            bound = signature.bind(*args, **kwargs)
        except TypeError:  # of the call itself, which Python tells
            return function(*args, **kwargs)
        for key, value in bound.arguments.items():
            bound.arguments[key] = _own(value, _array_due(function, key))
        args, kwargs = bound.args, bound.kwargs
        if not last:
            refuse_wrong(args, kwargs, strict=True)
            return function(*args, **kwargs)
        try:
            made = function(*args, **kwargs)
        except FretflowError:
            raise
        except Exception:
            refuse_wrong(args, kwargs, strict=True)
            raise
        refuse_wrong(args, kwargs, strict=False)
        return made

    return call


@cache
def _due(function: FunctionType, name: str, strict: bool) -> Like:
    """Return what an argument is annotated with; `strict` also of numbers and arrays which they are."""
    parameter = inspect.signature(function).parameters[name]
    if parameter.kind in (parameter.VAR_KEYWORD, parameter.VAR_POSITIONAL) or parameter.annotation is parameter.empty:
        return ANYTHING
    try:
        return _like(_annotation(function, name), strict)
    except (NameError, AttributeError):  # known to type checkers alone
        return ANYTHING


def _own(value: Any, due: Any) -> Any:
    """Return an argument with arrays of its own, as its maker may go on to change them and records make them read-only.

    What holds numbers, as lists and columns of tables do, is made an array where one is `due`; masked ones are NaN.
    """
    if type(value) is dict:
        return {name: _own(one, None) for name, one in value.items()}
    if getattr(value, "format", None) in ("dia", "dok", "lil"):
        return value.tocsc()  # sparse, but with next to no arithmetic
    if isinstance(value, np.ma.MaskedArray) and value.dtype.kind in "fiu":
        value = np.where(value.mask, np.nan, value.data)
    if due and not isinstance(value, np.generic) and (
            isinstance(value, list | tuple) or hasattr(value, "__array__")) and is_array(value):
        return np.array(value, dtype=due if due is np.float64 else None)
    return np.array(value) if isinstance(value, np.ndarray) and value.flags.writeable else value


def _annotation(function: FunctionType, name: str) -> Any:
    """Return what an argument is annotated with; an error where type checkers alone know it."""
    text = inspect.signature(function).parameters[name].annotation
    return eval(text, function.__globals__) if isinstance(text, str) else text


@cache
def _array_due(function: FunctionType, name: str) -> Any:
    """Return the numbers of the array that an argument is annotated as, maybe besides something else; None of none."""
    try:
        kind = _annotation(function, name)
    except (NameError, AttributeError):
        return None
    kind = get_args(kind)[0] if get_origin(kind) is Annotated else kind
    choices = get_args(kind) if get_origin(kind) in (Union, UnionType) else (kind,)
    numbers = [get_args(get_args(one)[1])[0] for one in choices if get_origin(one) is np.ndarray]
    return numbers[-1] if numbers else None


def is_array(value: Any, number: Any = np.float64, strict: bool = False) -> bool:
    """Return whether a value makes an array of such numbers; if `strict` of finite ones, in one or two dimensions."""
    try:
        given = np.asarray(value)
    except ValueError:  # rows of several lengths
        return False
    if given.dtype.kind not in ("fiu" if not issubclass(number, np.bool_ | np.complexfloating) else "fiucb"):
        return False
    return not strict or (given.ndim in (1, 2) and given.size > 0 and bool(np.isfinite(given).all()))


def _is_number(value: Any, kind: Any, strict: bool) -> bool:
    value = value[()] if isinstance(value, np.ndarray) and value.ndim == 0 else value
    return isinstance(value, kind) and not isinstance(value, bool) and (not strict or isfinite(abs(value)))


ANYTHING = Like("anything", lambda _: True)
_NUMBERS = {float: (Real, "a finite number"), int: (Integral, "a whole number"), complex: (Complex, "a finite number")}
_PLAIN = {
    Any: ANYTHING, str: Like("text", lambda value: isinstance(value, str)),
    NoneType: Like("None", lambda value: value is None),
    bool: Like("True or False", lambda value: isinstance(value, bool | np.bool_)),
}


def _like(kind: Any, strict: bool) -> Like:
    """Return what an annotation stands for."""
    origin, inner = get_origin(kind), get_args(kind)
    if origin is Annotated:
        return next((one for one in inner if isinstance(one, Like)), None) or _like(inner[0], strict)
    if origin in (Union, UnionType):
        choices = [_like(one, strict) for one in inner]
        return Like(" or ".join(dict.fromkeys(one.words for one in choices)),
                    lambda value: any(one.test(value) for one in choices))
    if origin is Literal:
        return Like(" or ".join(map(repr, inner)), lambda value: value in inner)
    if origin is np.ndarray:
        return Like("an array of finite numbers", partial(is_array, number=get_args(inner[1])[0], strict=strict))
    if getattr(origin or kind, "_is_protocol", False):
        return _object_of(origin or kind)
    if origin is not None:
        return _group_of(origin, inner, strict)
    if kind in _NUMBERS:
        number, words = _NUMBERS[kind]
        return Like(words, partial(_is_number, kind=number, strict=strict))
    return _PLAIN.get(kind) or (_object_of(kind) if isinstance(kind, type) else ANYTHING)


def _object_of(kind: Any) -> Like:
    """Return what is of a class, or has the members of a protocol."""
    if not getattr(kind, "_is_protocol", False):
        return Like(f"a {kind.__name__}", lambda value: isinstance(value, kind))
    members = {name for one in kind.__mro__ if getattr(one, "_is_protocol", False)
               for name in (*vars(one), *vars(one).get("__annotations__", ())) if not name.startswith("_")}
    return Like(f"a {kind.__name__}", lambda value: all(
        inspect.getattr_static(value, name, None) is not None for name in members))


def _group_of(origin: Any, inner: tuple[Any, ...], strict: bool) -> Like:
    """Return what is a function, a class, or a group of values that are of their kinds themselves."""
    if origin is Callable:
        return Like("a function", callable)
    if origin is type:
        return Like("a class", inspect.isclass)
    parts = [_like(one, strict) for one in inner if one is not ...]
    if issubclass(origin, Mapping):
        key, item = parts
        return Like(f"a mapping of {key.words} to {item.words}", lambda value: isinstance(value, origin) and all(
            key.test(one) and item.test(value[one]) for one in value))
    if origin is tuple and ... not in inner:
        return Like(f"a tuple of {', '.join(one.words for one in parts)}", lambda value: isinstance(value, tuple) and [
            one.test(held) for one, held in zip(parts, value, strict=False)] == [True] * len(parts))
    return Like(f"a sequence of {parts[0].words}", lambda value: isinstance(value, origin) and not isinstance(
        value, str | bytes) and all(parts[0].test(one) for one in (value if hasattr(value, "__len__") else ())))


def _shown(value: Any) -> str:
    if hasattr(value, "toarray"):
        return f"a sparse {type(value).__name__}; give its toarray()"
    text = " ".join(repr(value).split())
    text = text if len(text) <= MOST_SHOWN else f"{text[:MOST_SHOWN]}..."
    return text if isinstance(value, str | int | float | None) else f"{text}, a {type(value).__name__}"
