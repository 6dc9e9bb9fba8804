"""The models of a run as functions that the page calls: rates, forces, derivatives."""

import contextlib
import dataclasses
import json
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from pinav.actuation import HeldProgramme
from pinav.arguments import Scalar, State, Vector
from pinav.commands.explore.primitives import RULES
from pinav.commands.explore.printing import (
    Constants,
    Program,
    Tree,
    UnknownPrimitive,
    print_function,
)
from pinav.dynamics import (
    AbstractDynamics,
    AbstractSwimmer,
    OverdampedSwimmer,
    drive_by_arrays,
)
from pinav.errors import InputError
from pinav.fitting import Posterior
from pinav.forces import (
    AbstractForce,
    ConstantForce,
    Moving,
    ScheduledThrust,
    SumForce,
    Superposition,
    as_learned_force,
    forces_at,
)
from pinav.navigation.tables import FieldTable, Grid

SIDE = 97
"""Places along each side; half as many err eight times as much."""

MOMENTS = 9
"""Moments of a force that changes in time."""

MARGIN = 0.1
"""Share of the box by which a table goes beyond each side of it."""

CHECKED = 400
"""Random places at which a table is compared with its force."""


class TableBox(NamedTuple):
    """Box and times in which a force is tabulated.

    Attributes:
        lower: least x and y [L].
        upper: greatest x and y [L].
        times: first and last time [T].
    """

    lower: tuple[float, float]
    upper: tuple[float, float]
    times: tuple[float, float]


class TabulatedForce(AbstractForce):
    """A force that is read from a table, cubic in space and linear in time [F].

    Attributes:
        first: the time at which the table begins [T].
    """

    table: FieldTable
    first: Scalar

    def __call__(self, t: Scalar, x: Vector, v: Vector) -> Vector:
        return self.table(t - self.first, x)


def tabulate(force: AbstractForce, box: TableBox) -> tuple[TabulatedForce, float]:
    """A table of a force on a swimmer at rest, and its error.

    Args:
        box: where it is tabulated.

    Returns:
        The table, and the largest error that was found at random places, as a share of
        the largest force there.
    """
    lower, upper = np.array(box.lower), np.array(box.upper)
    margin = MARGIN * (upper - lower)
    lower, upper = lower - margin, upper + margin
    first, last = box.times
    generator = np.random.default_rng(0)
    points = generator.uniform(lower + margin, upper - margin, (CHECKED, 2))
    times = generator.uniform(first, last, CHECKED)
    exact = np.asarray(forces_at(force, times, points))
    is_static = np.array_equal(exact, forces_at(force, np.full(CHECKED, first), points))
    moments = np.linspace(first, last, 1 if is_static else MOMENTS)
    spacing = jnp.asarray((upper - lower) / (SIDE - 1))
    grid = Grid(jnp.asarray(lower), spacing, (SIDE, SIDE))
    values = [forces_at(force, np.full(grid.shape, t), grid.points) for t in moments]
    interval = (last - first) / max(len(moments) - 1, 1) or 1.0
    table = TabulatedForce(FieldTable(grid, jnp.stack(values), interval), first)
    missed = np.abs(np.asarray(forces_at(table, times, points)) - exact).max()
    return table, float(missed / max(np.abs(exact).max(), np.finfo(float).tiny))


Potential = Callable[[Scalar, Vector], Float[Array, ""]]


class OperatedForce(AbstractForce):
    """A propulsion as the reader of the page operates it.

    Attributes:
        thrust: factor of its size.
        turn: angle by which it is turned [rad].
    """

    force: AbstractForce
    thrust: Scalar
    turn: Scalar

    def __call__(self, t: Scalar, x: Vector, v: Vector) -> Vector:
        cos, sin = self.thrust * jnp.cos(self.turn), self.thrust * jnp.sin(self.turn)
        return jnp.array([[cos, -sin], [sin, cos]]) @ self.force(t, x, v)


@dataclasses.dataclass(frozen=True)
class Controls:
    """Commands that the reader of the page gives, as inputs of the printed functions.

    Attributes:
        count: number of commands over time that a propulsion takes; None where the
            propulsions take none, and are multiplied and turned.
    """

    count: int | None

    @property
    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Shape of each input, by name."""
        if self.count is None:
            return {"thrust": (), "turn": ()}
        return dict.fromkeys(("times", "frequency", "heading"), (self.count,))

    def operate(self, model: Any, values: tuple[Any, ...]) -> Any:
        """A model under these commands."""
        if self.count is not None:
            times, frequency, heading = values
            commands = {"frequency": frequency, "heading": heading}
            return drive_by_arrays(model, times, commands)
        if not isinstance(model, AbstractSwimmer):
            return model
        propulsion = OperatedForce(model.propulsion, *values)
        return dataclasses.replace(model, propulsion=propulsion)


class Programs:
    """The printed functions of a run.

    Args:
        controls: what the reader operates.
        box: where a force that cannot be printed is tabulated.
    """

    def __init__(self, controls: Controls, box: TableBox) -> None:
        self.controls = controls
        self.box = box
        self.constants = Constants()
        self._texts: list[str] = []

    @property
    def text(self) -> str:
        """JavaScript of all functions, an object for each model in a list."""
        arrays = [
            f"const K{k} = arrayOf({json.dumps(packed)});"
            for k, packed in enumerate(self.constants.packed)
        ]
        return "\n".join([*arrays, f"const PROGRAMS = [{', '.join(self._texts)}];"])

    def add(self, model: AbstractDynamics, posterior: Posterior | None = None) -> Tree:
        """Print a model; returns what the page has to know of it.

        A force of the environment with an operation that is not printed is read from a
        table, and has no posterior.

        Args:
            model: the dynamics.
            posterior: of its parameters, if it has one.

        Raises:
            InputError: another part of the model cannot be printed.
        """
        try:
            return self._add(_ModelPrinter(self, model, posterior))
        except UnknownPrimitive as unknown:
            if isinstance(model, AbstractSwimmer):
                table, error = tabulate(model.environment, self.box)
                with contextlib.suppress(UnknownPrimitive):
                    printer = _ModelPrinter(self, model.with_environment(table), None)
                    return {**self._add(printer), "tableError": error}
            raise InputError(
                f"explore: the page cannot evaluate this {type(model).__name__}; its "
                f"propulsion, drag or network has the operation {str(unknown)!r} of "
                "JAX, write it without"
            ) from unknown

    def add_steered(self, model: Any) -> Tree:
        """Print a swimmer whose propulsion is an input; returns as `add` does."""

        def rate(t: Scalar, y: State, steer: Vector) -> State:
            return dataclasses.replace(model, propulsion=ConstantForce(steer))(t, y)

        late = {"t": (), "y": (_states(model),), "steer": (2,)}
        program = print_function(rate, {}, late, self.constants, RULES)
        return {"program": self._keep({"rate": program})}

    def _add(self, printer: "_ModelPrinter") -> Tree:
        programs = printer.programs()
        force = programs.get("force")
        return {
            "program": self._keep(programs),
            "states": printer.states,
            "firstDriven": printer.states - 2,
            "timed": force is None or "t" in force.inputs,
            "parameters": printer.count,
        }

    def _keep(self, programs: dict[str, Program]) -> int:
        parts = [f"{name}: {program.text}" for name, program in programs.items()]
        self._texts.append("{" + ",\n".join(parts) + "}")
        return len(self._texts) - 1


class _ModelPrinter:
    """Prints the functions of one model.

    Args:
        programs: those of the run.
    """

    def __init__(
        self, programs: Programs, model: Any, posterior: Posterior | None
    ) -> None:
        self.controls = programs.controls
        self.constants = programs.constants
        self.fixed = model
        self.free = None if posterior is None else posterior.free
        self.count = 0 if posterior is None else len(posterior.mean)
        self.states = _states(model)

    def programs(self) -> dict[str, Program]:
        """All functions of the model, by their names."""
        place: dict[str, tuple[int, ...]] = {"t": (), "x": (2,)}
        state: dict[str, tuple[int, ...]] = {"t": (), "y": (self.states,)}
        printed = {"rate": self._print(_rate, **state)}
        if not isinstance(self.fixed, AbstractSwimmer):
            return printed
        printed["force"] = self._print(_force, **place)
        if potential_of(self.fixed.environment) is not None:
            printed["potential"] = self._print(_potential, **place)
        shapes = [jax.ShapeDtypeStruct(s, float) for s in self._early().values()]
        if (
            jax.eval_shape(lambda *early: _jumps(self._model(*early)), *shapes)
            is not None
        ):
            printed["jumps"] = self._print(_jumps)
        if self.free is not None:
            printed["basis"] = self._print_jacobian(_force, **place)
            printed["columns"] = self._print_jacobian(_driven_rate, **state)
        return printed

    def _early(self) -> dict[str, tuple[int, ...]]:
        return {"theta": (self.count,), **self.controls.shapes}

    def _model(self, theta: Any, *controls: Any) -> Any:
        model = self.fixed if self.free is None else self.free(theta)
        return self.controls.operate(model, controls)

    def _print(self, function: Callable[..., Any], **late: tuple[int, ...]) -> Program:
        """A function of a model and the late inputs."""
        early = self._early()

        def of_inputs(*inputs: Any) -> Any:
            model = self._model(*inputs[: len(early)])
            return function(model, *inputs[len(early) :])

        return print_function(of_inputs, early, late, self.constants, RULES)

    def _print_jacobian(
        self, function: Callable[..., Vector], **late: tuple[int, ...]
    ) -> Program:
        """Derivatives of a vector by the parameters, one column each.

        Weights of the environment are many, and cost the same together in reverse mode.
        Constants are few, and forward mode leaves their table of commands alone.
        """
        free, early = self.free, self._early()
        assert free is not None

        def jacobian(theta: Any, *inputs: Any) -> Float[Array, "2 parameter"]:
            controls, rest = inputs[: len(early) - 1], inputs[len(early) - 1 :]
            paths, tree = jax.tree_util.tree_flatten_with_path(free.unravel(theta))
            weights, constants = {}, {}
            for k, (path, leaf) in enumerate(paths):
                is_weight = jax.tree_util.keystr(path).startswith(".environment")
                (weights if is_weight else constants)[k] = leaf

            def of(weights: dict[int, Any], constants: dict[int, Any]) -> Vector:
                leaves = weights | constants
                ordered = tree.unflatten([leaves[k] for k in range(len(paths))])
                model = eqx.combine(ordered, free.static)
                return function(self.controls.operate(model, controls), *rest)

            columns = jax.jacrev(of)(weights, constants) if weights else {}
            if constants:
                columns |= jax.jacfwd(of, argnums=1)(weights, constants)
            rows = [columns[k].reshape(2, -1) for k in range(len(paths))]
            return jnp.concatenate(rows, axis=1)

        return print_function(jacobian, early, late, self.constants, RULES)


def potential_of(force: AbstractForce) -> Potential | None:
    """The potential of a force, of its gradient part where it holds both apart."""
    if isinstance(force, SumForce | Superposition):
        terms = [potential_of(term) for term in force.terms]
        if None in terms or not terms:
            return None
        return lambda t, x: sum(
            (term(t, x) for term in terms if term), jnp.asarray(0.0)
        )
    if isinstance(force, Moving):
        still = potential_of(force.force)
        return still and (lambda t, x: still(t, x - force.motion(t)))
    learned = as_learned_force(force)
    if learned is not None and learned.helmholtz is not None:
        return potential_of(learned.helmholtz.gradient)
    potential: Any = getattr(force, "potential", None)
    try:
        jax.eval_shape(potential, 0.0, jnp.zeros(2))  # a rotational term has none
    except (InputError, TypeError):
        return None
    return potential


def _rate(model: Any, t: Scalar, y: State) -> State:
    return model(t, y)


def _driven_rate(model: Any, t: Scalar, y: State) -> Vector:
    """Rate of change of what parameters act upon: velocities, where there are some."""
    return model(t, y)[-2:]


def _force(model: Any, t: Scalar, x: Vector) -> Vector:
    return model.environment(t, x, jnp.zeros_like(x))


def _potential(model: Any, t: Scalar, x: Vector) -> Float[Array, ""]:
    height = potential_of(model.environment)
    assert height is not None
    return height(t, x)


def _jumps(model: Any) -> Float[Array, " jump"] | None:
    """Times at which a thrust jumps, of a programme of the system as well."""
    propulsion: Any = model.propulsion
    if isinstance(propulsion, OperatedForce):
        propulsion = propulsion.force
    if isinstance(propulsion, ScheduledThrust):
        return propulsion.jumps
    programme = getattr(propulsion, "programme", None)
    if isinstance(programme, HeldProgramme):
        return programme.times + propulsion.delay
    return None


def _states(model: Any) -> int:
    return 2 if isinstance(model, OverdampedSwimmer) else 4
