"""Classes of results, from the tables of the core: read-only attributes that are printed and pickled."""

import dataclasses
import re
from typing import Any


def make(name: str, doc: str, fields: list[tuple[str, str]]) -> type:
    """A class with these (attribute, documentation)."""
    lines = [doc.strip(), "", *(f"{field}: {' '.join(text.split())}" for field, text in fields)]
    plain = re.sub(r"\[(`[^]]+`)\](\([^)]*\)+)?", r"\1", "\n".join(lines))  # without the links of Rust
    namespace = {"__doc__": plain, "__repr__": shown, "__module__": "snake_rs"}
    return dataclasses.make_dataclass(name, [field for field, _ in fields], namespace=namespace, frozen=True, eq=False)


def shown(result: Any) -> str:
    """A result with its attributes, arrays by their shape, and long lists by their length."""

    def text(value: Any) -> str:
        if hasattr(value, "shape"):
            return f"array of shape {value.shape}"
        return f"list of {len(value)}" if isinstance(value, list) and len(value) > 3 else repr(value)

    values = (f"{field.name}={text(getattr(result, field.name))}" for field in dataclasses.fields(result))
    return f"{type(result).__name__}({', '.join(values)})"
