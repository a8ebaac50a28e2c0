"""Groups of options: a frozen dataclass whose fields are options, defined once for all commands."""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import MISSING, fields, is_dataclass
from functools import wraps
from inspect import Parameter, Signature, signature
from operator import getitem
from typing import Annotated, Any, get_args, get_type_hints

from typer.models import OptionInfo

from mobilestereonet.cli.panels import panel_of, place_in_help

_METAVARS: dict[Any, str] = {bool: "", bool | None: "", int: "<n>", int | None: "<n>"}
"""What the help shows in place of an option's value, by its type: a flag takes none."""


def with_options_of_groups(command: Callable[..., None]) -> Callable[..., None]:
    """A command as Typer takes it, with an option per field for each parameter that is a group.

    A parameter of the command with a field's name takes the field's place, with a help text and a
    default of its own; the group then has the field's default. So does a field of an earlier group.
    Options get their panel in the help, and the shell completes them where their check knows all
    names.

    Args:
        command: Function whose parameters are annotated with Typer's options, or with dataclasses
            whose fields are.
    """
    own = signature(command, eval_str=True).parameters
    groups = {name: own[name].annotation for name in own if is_dataclass(own[name].annotation)}
    owners: dict[str, str] = {}
    for name, group in groups.items():
        for field in fields(group):
            if field.name not in own:
                owners.setdefault(field.name, name)
    options: list[Parameter] = []
    for name, parameter in own.items():
        if name not in groups:
            options.append(_option(name, parameter.default, parameter.annotation))
            continue
        kinds = get_type_hints(groups[name], include_extras=True)
        options += [
            _option(field.name, field.default, kinds[field.name])
            for field in fields(groups[name])
            if owners.get(field.name) == name
        ]
    options.sort(
        key=lambda option: place_in_help(option.name, _info(option.annotation).rich_help_panel)
    )

    @wraps(command)
    def expanded(**values: Any) -> None:
        for name, group in groups.items():
            names = [option for option, owner in owners.items() if owner == name]
            values[name] = group(**{option: values.pop(option) for option in names})
        command(**values)

    expanded.__signature__ = Signature(options)  # type: ignore[attr-defined]
    expanded.__annotations__ = {option.name: option.annotation for option in options}
    return expanded


def _option(name: str, default: Any, annotation: Any) -> Parameter:
    """A parameter as Typer takes it, with its panel and its completion."""
    info = copy(_info(annotation))
    default = Parameter.empty if default is MISSING else default
    if isinstance(info, OptionInfo):
        info.rich_help_panel = info.rich_help_panel or panel_of(name)
        if info.metavar is None:
            info.metavar = _METAVARS.get(get_args(annotation)[0])
    info.autocompletion = info.autocompletion or getattr(info.callback, "complete", None)
    annotation = getitem(Annotated, (get_args(annotation)[0], info))
    return Parameter(name, Parameter.KEYWORD_ONLY, default=default, annotation=annotation)


def _info(annotation: Any) -> Any:
    """What Typer knows about a parameter, of ``Annotated[...]``."""
    return get_args(annotation)[1]
