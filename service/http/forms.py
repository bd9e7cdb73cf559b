"""Requests as JSON, or as a multipart form with the files in it, so that one `curl` does it."""

import json
from collections.abc import Mapping, Sequence
from typing import Any, TypeVar

from fastapi import Request
from pydantic import BaseModel, BeforeValidator, ConfigDict, JsonValue, ValidationError, model_validator
from starlette.datastructures import UploadFile
from starlette.formparsers import MultiPartException

from service.http.error_responses import invalid
from service.problems import Problem


def check_text(text: str) -> str:
    """A text that every database holds; ValueError where it has a NUL, or half of a surrogate pair."""
    if "\0" in text or (not text.isascii() and any("\ud800" <= letter <= "\udfff" for letter in text)):
        raise ValueError("a text must not hold NUL characters, nor halves of surrogate pairs")
    return text


class RequestBody(BaseModel):
    """Body of a request: no fields but its own, and texts that every database holds."""

    model_config = ConfigDict(extra="forbid")

    @model_validator(mode="before")
    @classmethod
    def _texts(cls, values: Any) -> Any:
        for value in values.values() if isinstance(values, dict) else ():
            for text in value if isinstance(value, list) else [value]:
                if isinstance(text, str):
                    check_text(text)
        return values


T = TypeVar("T", bound=RequestBody)
Files = dict[str, list[UploadFile]]
MAX_FILES, MAX_FIELDS = 66, 32


def _whole(value: Any) -> Any:
    return int(value) if isinstance(value, float) and value.is_integer() else value


WHOLE = BeforeValidator(_whole)
"""For whole numbers: in JSON, 2.0 is one too. It stands after the `Field` with the limits, which it hides otherwise."""

FROM_JSON = BeforeValidator(lambda text: json.loads(text) if text else None)
"""For what a row holds as JSON text."""


async def read_form(request: Request, kind: type[T], files: Sequence[str]) -> tuple[T, Files]:
    """The request as a model, and the files that came with it, of the fields that may hold `files`."""
    media = request.headers.get("content-type", "").split(";")[0].strip().lower()
    values: Mapping[str, JsonValue]
    found: Files = {}
    if media == "application/json":
        values = await _json_object(request)
    elif media == "multipart/form-data":
        values, found = await _form_fields(request, files)
    else:
        text = f"send a form with the file in it (curl -F {files[0]}=@FILE) or application/json, not {media!r}"
        raise Problem("unsupported-media-type", text)
    try:
        return kind.model_validate(values, strict=media == "application/json"), found
    except ValidationError as error:
        raise invalid([{**entry, "loc": ("body", *entry["loc"])} for entry in error.errors()]) from None


async def _json_object(request: Request) -> Mapping[str, JsonValue]:
    try:
        values = json.loads(await request.body())
    except ValueError as error:
        raise Problem("malformed-request", f"the body is no JSON: {error}") from None
    except RecursionError:
        raise Problem("malformed-request", "the body is no JSON that can be read: it nests too deep") from None
    if not isinstance(values, dict):
        raise Problem("invalid-request", f"the body must be a JSON object, got {type(values).__name__}")
    return values


async def _form_fields(request: Request, files: Sequence[str]) -> tuple[Mapping[str, JsonValue], Files]:
    """A form's text fields, and its files, which may stand in the fields `files` only."""
    try:
        form = await request.form(max_files=MAX_FILES, max_fields=MAX_FIELDS)
    except MultiPartException as error:
        raise Problem("malformed-request", f"the form cannot be read: {error.message}") from None
    values: dict[str, JsonValue] = {}
    found: Files = {}
    for name, value in form.multi_items():
        if isinstance(value, UploadFile):
            if name not in files:
                raise Problem("invalid-request", f"{name}: no file is taken under this name")
            found.setdefault(name, []).append(value)
        elif name in files:
            raise Problem("invalid-request", f"{name}: must be a file")
        elif value != "":  # an empty field of a form is one left out
            values[name] = value
    return values, found


def form_schema(
    kind: type[BaseModel],
    files: dict[str, tuple[str, bool]],
    without: Sequence[str],
    required: Sequence[str] = (),
    ways: Mapping[str, Sequence[str]] | None = None,
) -> dict[str, Any]:
    """OpenAPI `requestBody` for `read_form`; `files`: field -> (description, several files?).

    A form needs no properties `without`, since the files stand for them, and must have the fields `required`. Which of
    them go together is said for JSON only: `ways` has, for each form of the request, its title and those of `without`
    that it takes, the first of which it needs. Each is a whole schema: client generators lose siblings of a `oneOf`.
    """
    schema = kind.model_json_schema()
    binary = {"type": "string", "format": "binary"}
    form = {**schema, "properties": {k: v for k, v in schema["properties"].items() if k not in without}}
    for rule in ("examples", "not", "required"):
        form.pop(rule, None)
    if required:
        form["required"] = list(required)
    for name, (text, several) in files.items():
        form["properties"][name] = (
            {"type": "array", "items": binary, "maxItems": 64, "description": text}
            if several
            else {**binary, "description": text}
        )
    if ways:
        schema = {"oneOf": [_way(schema, title, without, taken) for title, taken in ways.items()]}
    content = {"application/json": {"schema": schema}, "multipart/form-data": {"schema": form}}
    return {"requestBody": {"required": True, "content": content}}


def _way(schema: dict[str, Any], title: str, without: Sequence[str], taken: Sequence[str]) -> dict[str, Any]:
    """The schema of one form of the request."""
    left = {name: value for name, value in schema["properties"].items() if name in taken or name not in without}
    needed = {name: value for name, value in left[taken[0]].items() if name not in ("anyOf", "default")}
    # What must be there is not null, and of a list it is one entry at least.
    needed |= left[taken[0]]["anyOf"][0] if "anyOf" in left[taken[0]] else {"minItems": 1}
    examples = [example for example in schema["examples"] if taken[0] in example]
    return {**schema, "title": title, "properties": {**left, taken[0]: needed}, "required": [taken[0]]} | {
        "examples": examples
    }
