"""Kernel signatures as JSON, to compile kernels without calling them."""

from __future__ import annotations

import importlib
from typing import Any

from numba import types


def encode_type(type_: Any) -> Any:
    """Turn a Numba type into JSON.

    Parameters
    ----------
    type_ : numba type
        A number, None, an array of numbers, an optional value, or a (named) tuple of these.

    Returns
    -------
    str, list or dict
        None for other types, such as functions.
    """
    if isinstance(type_, types.BaseNamedTuple):
        members = [encode_type(member) for member in type_.types]
        cls = type_.instance_class
        name = f"{cls.__module__}:{cls.__qualname__}"
        return None if None in members else {"tuple": name, "of": members}
    if isinstance(type_, types.BaseTuple):
        members = [encode_type(member) for member in type_.types]
        return None if None in members else members
    if isinstance(type_, types.Array):
        element = encode_type(type_.dtype)
        if not isinstance(element, str) or not type_.aligned:
            return None
        return {"array": element, "ndim": type_.ndim, "layout": type_.layout} | (
            {} if type_.mutable else {"mutable": False}
        )
    if isinstance(type_, types.Optional):
        inner = encode_type(type_.type)
        return None if inner is None else {"optional": inner}
    name = str(type_)
    return name if getattr(types, name, None) == type_ else None


def decode_type(code: Any) -> Any:
    """Turn JSON from `encode_type` into the Numba type.

    Raises
    ------
    ValueError
        If it names an unknown type.
    """
    try:
        if isinstance(code, str):
            return getattr(types, code)
        if isinstance(code, list):
            return types.BaseTuple.from_types([decode_type(member) for member in code])
        if "tuple" in code:
            module, _, name = code["tuple"].partition(":")
            cls = getattr(importlib.import_module(module), name)
            return types.BaseTuple.from_types([decode_type(one) for one in code["of"]], cls)
        if "array" in code:
            return types.Array(
                decode_type(code["array"]),
                code["ndim"],
                code["layout"],
                readonly=not code.get("mutable", True),
            )
        return types.Optional(decode_type(code["optional"]))
    except (AttributeError, ImportError, KeyError, TypeError) as error:
        raise ValueError(f"{code}: {error}") from error
