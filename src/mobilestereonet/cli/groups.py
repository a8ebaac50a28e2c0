"""Groups of options: a frozen dataclass whose fields are options, defined once for all commands."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, is_dataclass
from functools import wraps
from inspect import Parameter, Signature, signature
from typing import Any, get_type_hints


def with_options_of_groups(command: Callable[..., None]) -> Callable[..., None]:
    """A command as Typer takes it, with an option per field for each parameter that is a group.

    A parameter of the command with a field's name takes the field's place, with a help text and a
    default of its own; the group then has the field's default.

    Args:
        command: Function whose parameters are annotated with Typer's options, or with dataclasses
            whose fields are.
    """
    hints = get_type_hints(command, include_extras=True)
    own = signature(command).parameters
    groups = {name: hints[name] for name in own if is_dataclass(hints[name])}
    options: list[Parameter] = []
    for name, parameter in own.items():
        if name not in groups:
            parameter = parameter.replace(annotation=hints[name], kind=Parameter.KEYWORD_ONLY)
            options.append(parameter)
            continue
        kinds = get_type_hints(groups[name], include_extras=True)
        options += [
            Parameter(
                field.name,
                Parameter.KEYWORD_ONLY,
                default=field.default,
                annotation=kinds[field.name],
            )
            for field in fields(groups[name])
            if field.name not in own
        ]

    @wraps(command)
    def expanded(**values: Any) -> None:
        for name, group in groups.items():
            names = [field.name for field in fields(group) if field.name not in own]
            values[name] = group(**{option: values.pop(option) for option in names})
        command(**values)

    expanded.__signature__ = Signature(options)  # type: ignore[attr-defined]
    expanded.__annotations__ = {option.name: option.annotation for option in options}
    return expanded
