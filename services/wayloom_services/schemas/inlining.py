"""JSON schemas of bodies that an endpoint parses itself."""

from typing import Any

from pydantic import BaseModel


def inlined_schema(model: type[BaseModel]) -> dict[str, Any]:
    """JSON schema of a body that the endpoint parses itself, without references."""
    schema = model.model_json_schema()
    named = {f"#/$defs/{name}": definition for name, definition in schema.pop("$defs", {}).items()}

    def inline(part: Any) -> Any:
        if isinstance(part, dict):
            return inline(named[part["$ref"]]) if "$ref" in part else {key: inline(value) for key, value in part.items()}
        return [inline(one) for one in part] if isinstance(part, list) else part

    found: dict[str, Any] = inline(schema)
    return found
