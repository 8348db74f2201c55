"""Arguments held against their annotations: what public functions and data classes are called with.

A value of another type would fail somewhere inside, in words that are not about it. Here it is refused by
its name, at the door. What a value of the right type may be, e.g. which numbers, is checked where it is used.
"""

from __future__ import annotations

import collections.abc as abc
import dataclasses
import functools
import inspect
import os
import types
import typing
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from scso_nlp.exceptions import ArgumentError
from scso_nlp.text import shown

_Thing = TypeVar("_Thing", bound=Callable[..., Any])

#: How one value and several values of plain types are called in messages.
_WORDS: dict[Any, tuple[str, str]] = {
    bool: ("true or false", "true or false"),
    int: ("a whole number", "whole numbers"),
    float: ("a number", "numbers"),
    str: ("text", "text"),
    object: ("anything", "anything"),
    Path: ("a path", "paths"),
    os.PathLike: ("a path", "paths"),
    type(None): ("None", "None"),
    np.ndarray: ("an array of numbers", "arrays of numbers"),
    abc.Callable: ("a function", "functions"),
}


def checked(thing: _Thing) -> _Thing:
    """Refuse arguments that are not what a function's, or a data class's, annotations say.

    Stands below ``@dataclass``: fields are checked before ``__post_init__`` sees them.

    Parameters
    ----------
    thing : function or class

    Returns
    -------
    function or class
        It raises :class:`~scso_nlp.exceptions.ArgumentError`, with the argument's name.
    """
    return checked_as()(thing)


def checked_as(**instead: Any) -> Callable[[_Thing], _Thing]:
    """Do as :func:`checked`, with other types for some arguments.

    Parameters
    ----------
    **instead
        Types by argument, where more is accepted than the annotation says because it is converted.

    Returns
    -------
    decorator
    """

    def decorate(thing: _Thing) -> _Thing:
        if isinstance(thing, type):
            _check_fields(thing, instead)
            return thing
        signature, hints = inspect.signature(thing), _Hints(thing, instead)

        @functools.wraps(thing)
        def call(*args: Any, **kwargs: Any) -> Any:
            try:
                given = signature.bind(*args, **kwargs).arguments
            except TypeError:
                return thing(*args, **kwargs)  # whose own sentence is about the call
            for name, value in given.items():
                several = signature.parameters[name].kind is inspect.Parameter.VAR_POSITIONAL
                for each in value if several else (value,):
                    hints.check(name, each)
            return thing(*args, **kwargs)

        return typing.cast(_Thing, call)

    return decorate


def _check_fields(data: type, instead: dict[str, Any]) -> None:
    further = getattr(data, "__post_init__", None)
    hints = _Hints(data, instead)

    def __post_init__(self: Any) -> None:
        for field in dataclasses.fields(data):
            hints.check(field.name, getattr(self, field.name))
        if further is not None:
            further(self)

    data.__post_init__ = __post_init__  # type: ignore[attr-defined]


class _Hints:
    """Annotations of a function or class, read when they are first needed."""

    def __init__(self, owner: Any, instead: dict[str, Any]) -> None:
        self.owner, self.instead = owner, instead

    @functools.cached_property
    def types(self) -> dict[str, Any]:
        return typing.get_type_hints(self.owner) | self.instead

    def check(self, name: str, value: object) -> None:
        hint = self.types.get(name, Any)
        if not _test_of(hint)(value):
            who = self.owner.__qualname__.removesuffix(".__init__")
            raise ArgumentError(f"{who}: {name} is {shown(value)}, expected {_words(hint)}")


def _meant(hint: Any) -> Any:
    """Give what an alias made by ``type`` stands for, as NumPy's ``NDArray`` is one in newer versions."""
    while hasattr(hint, "__value__"):
        hint = hint.__value__
    return hint


@functools.cache
def _test_of(hint: Any) -> Callable[[Any], bool]:
    """Make the test for an annotated type; numbers and arrays of NumPy's own types count as such."""
    hint = _meant(hint)
    origin, parts = typing.get_origin(hint) or hint, typing.get_args(hint)
    if origin in (typing.Union, types.UnionType):
        tests = [_test_of(part) for part in parts]
        return lambda value: any(test(value) for test in tests)
    if origin is typing.Literal:
        return lambda value: isinstance(value, str) and value in parts
    if origin is np.ndarray:
        return _is_numeric
    if origin is abc.Callable:
        return callable
    is_protocol = getattr(origin, "_is_protocol", False) and origin is not os.PathLike
    if hint is Any or not isinstance(origin, type) or is_protocol:
        return lambda _: True
    if origin is float:
        return _is_number
    if origin is int:
        return lambda value: _is_number(value) and isinstance(value, int | np.integer)
    if origin is bool:
        return lambda value: isinstance(value, bool | np.bool_)
    if _is_symbolic(origin):
        return lambda value: _is_symbolic(type(value)) or _is_numeric(value)
    if issubclass(origin, abc.Mapping):
        key, item = (_test_of(part) for part in parts or (Any, Any))
        return lambda value: (
            isinstance(value, abc.Mapping) and all(map(key, value)) and all(map(item, value.values()))
        )
    if origin is str or not issubclass(origin, abc.Iterable):
        return lambda value: isinstance(value, origin)
    return _test_of_several(origin, parts)


def _test_of_several(origin: type, parts: tuple[Any, ...]) -> Callable[[Any], bool]:
    """Make the test for tuples, sequences and the like; text is a sequence of names, but no tuple of them."""
    is_tuple = issubclass(origin, tuple)
    takes_text = not is_tuple and parts[:1] == (str,)
    tests = [_test_of(part) for part in parts if part is not ...]
    is_fixed = is_tuple and len(tests) == len(parts)

    def test(value: Any) -> bool:
        if isinstance(value, str):
            return takes_text
        if isinstance(value, bytes | abc.Mapping) or not isinstance(value, abc.Iterable):
            return False
        if _is_symbolic(type(value)) or (isinstance(value, np.ndarray) and value.ndim == 0):
            return False
        if not isinstance(value, abc.Collection) or not tests:
            return True  # what cannot be looked at twice is looked at where it is used
        if is_fixed:
            return len(value) == len(tests) and all(each(v) for each, v in zip(tests, value, strict=True))
        return all(map(tests[0], value))

    return test


def _is_symbolic(kind: type) -> bool:
    return kind.__module__.startswith("casadi")


def _is_number(value: object) -> bool:
    """Tell if a value is a real number, of Python or NumPy, among the doubles."""
    if isinstance(value, bool) or not isinstance(value, float | int | np.floating | np.integer):
        return False
    try:
        return isinstance(float(value), float)
    except OverflowError:
        return False


def _is_numeric(value: object) -> bool:
    """Tell if a value can become an array of real numbers, none of them masked."""
    if isinstance(value, np.ma.MaskedArray):
        return False
    try:
        array = np.asarray(value)
        return array.dtype.kind in "biuf" or (array.dtype.kind == "O" and all(map(_is_number, array.flat)))
    except (TypeError, ValueError, RuntimeError):
        return False


def _words(hint: Any, *, several: bool = False) -> str:
    """Say what is expected, one of it or several."""
    hint = _meant(hint)
    origin, parts = typing.get_origin(hint) or hint, typing.get_args(hint)
    if origin in (typing.Union, types.UnionType):
        *others, last = dict.fromkeys(_words(part, several=several) for part in parts)
        return f"{', '.join(others)} or {last}" if others else last
    if origin is typing.Literal:
        return " or ".join(map(repr, parts))
    if origin in _WORDS:
        return _WORDS[origin][several]
    if not isinstance(origin, type):
        return "anything"
    if _is_symbolic(origin):
        return "CasADi expressions" if several else "a CasADi expression"
    if issubclass(origin, abc.Mapping):
        key, item = parts or (str, object)
        return f"a mapping of {_words(key, several=True)} to {_words(item, several=True)}"
    if issubclass(origin, abc.Iterable):
        what = [_words(part, several=True) for part in parts if part is not ...]
        return f"{'sequences' if several else 'a sequence'}{' of ' if what else ''}{' and '.join(what)}"
    if several:
        return f"objects of {origin.__name__}"
    return f"{'an' if origin.__name__[0] in 'AEIOU' else 'a'} {origin.__name__}"
