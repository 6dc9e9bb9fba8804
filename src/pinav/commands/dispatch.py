"""The way of every command: parse, check, run, print, write the report."""

import os
import sys
from collections.abc import Callable, Sequence

import msgspec

from pinav.commands.command import Command, CommandResult, resolve
from pinav.commands.parsing import parse
from pinav.commands.settings import Settings
from pinav.errors import InputError


def execute(
    command: Command, argv: Sequence[str], on_start: Callable[[], None] = lambda: None
) -> None:
    """Parse the words after a command, run it and show what it found.

    Args:
        on_start: called when all modules are imported and the run begins.

    Raises:
        InputError: an option is unknown, misses its value or has a wrong one.
        FitError: the command has failed honestly.
    """
    options = parse(resolve(command.options), argv, prog=command.words)
    if options is None:
        return
    if isinstance(options, Settings):
        options.check()
    _prepare_jax()
    run = resolve(command.run)
    from pinav.manifest import REPAIR

    REPAIR.set(_repair(command))
    on_start()
    result = run(options)
    _show(command, result, as_json=getattr(options, "json", False))


def _repair(command: Command) -> str:
    """How files that a command wrote are made again."""
    again = f"repeat {command.words}"
    if not command.title:
        return again
    if not command.resumable:
        return f"{again} with --overwrite"
    return f"delete it and {again} with --resume"


def _prepare_jax() -> None:
    import jax

    jax.config.update("jax_enable_x64", val=True)
    if platforms := os.environ.get("JAX_PLATFORMS"):
        try:
            jax.devices()
        except (RuntimeError, AssertionError) as error:
            raise InputError(
                f"JAX cannot use the device that JAX_PLATFORMS names ({platforms}); "
                "unset it, or set it to cpu"
            ) from error


def _show(command: Command, result: CommandResult, *, as_json: bool) -> None:
    """Write the run's report; print its metrics, as JSON alone or for people."""
    page = result.page
    if result.folder is not None:
        from pinav.commands.results import write_report

        page = write_report(result.folder, command)
    if as_json:
        json = msgspec.json.format(msgspec.json.encode(result.metrics), indent=2)
        sys.stdout.write(json.decode() + "\n")
    else:
        lines = [result.text] if result.text else []
        lines += [f"report: {page}"] if page else []
        if lines:
            print("\n".join(lines))
