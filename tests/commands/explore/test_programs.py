"""Printed functions in Node have the numbers of the package, for each force."""

import json

import equinox as eqx
import jax
import jax.flatten_util
import jax.numpy as jnp
import numpy as np
import pytest
from tests.commands.explore.node import answer, needs_node
from tests.forces.test_forces import FORCES

import pinav.forces as forces
from pinav.actuation import StepOutResponse
from pinav.commands.explore import printing
from pinav.commands.explore.document import script_json
from pinav.commands.explore.payload import payload_of
from pinav.commands.explore.primitives import RULES
from pinav.commands.explore.programs import MARGIN, TableBox, tabulate
from pinav.dynamics import FixedStep, drive_by_arrays, rollout
from pinav.forces.fitted_laws import FittedLaw
from pinav.learning.learned import Learned

pytestmark = needs_node

BAR = 1e-3
"""Of the extent of the data."""


class Entries:
    """Printed functions, which are asked in one call of Node."""

    def __init__(self):
        self.constants, self.calls, self.expected = printing.Constants(), [], {}

    def add(self, name, function, early, late):
        """Print a function; its entries are compared with its own results."""
        shapes = [{n: np.shape(v) for n, v in part.items()} for part in (early, late)]
        program = printing.print_function(function, *shapes, self.constants, RULES)
        before, after = (", ".join(map(argument, p.values())) for p in (early, late))
        # Called twice: no call may leave anything behind in its buffers.
        self.calls.append(
            f"""(() => {{ const call = ({program.text})({before}), out = [];
            call({after}{", " * bool(after)}out);
            call({after}{", " * bool(after)}out); return out; }})()"""
        )
        values = jax.jit(function)(*map(jnp.asarray, early.values()), *late.values())
        self.expected[name] = np.ravel(values)
        return program

    def check(self, rtol=1e-9):
        """Each entry is that of the package."""
        packed = enumerate(self.constants.packed)
        held = [f"const K{k} = arrayOf({json.dumps(c)});" for k, c in packed]
        results = answer(f"{' '.join(held)}\nreturn [{', '.join(self.calls)}];")
        for (name, expected), entries in zip(
            self.expected.items(), results, strict=True
        ):
            np.testing.assert_allclose(
                np.array(entries, float), expected, rtol=rtol, atol=1e-13, err_msg=name
            )


def argument(value):
    """A number or an array as an argument in JavaScript."""
    if np.shape(value) == ():
        return printing.number(float(value))
    return f"Float64Array.from({np.ravel(value).tolist()})"


POINT = {"t": 0.7, "x": jnp.array([4.3, 5.4]), "v": jnp.array([0.4, -0.3])}


CENTERS = np.stack(np.meshgrid(*(np.arange(0.0, 4.0),) * 2), -1).reshape(-1, 2)
FEATURES = forces.PositionTimeFeatures((1.0, 2.0, 3.0), (2.0, 3.0, 4.0))


def random(force, key=0):
    """The force with random numbers in place of its zero weights."""
    leaves, tree = jax.tree.flatten(force.parameters)
    keys = jax.random.split(jax.random.key(key), len(leaves))
    drawn = [
        jax.random.normal(k, leaf.shape) for k, leaf in zip(keys, leaves, strict=True)
    ]
    return eqx.tree_at(lambda f: f.parameters, force, tree.unflatten(drawn))


def network(outputs):
    return forces.tanh_network(3, outputs, width=5, depth=2, key=jax.random.key(1))


def changing():
    timed = forces.TimedKernelPotential(
        jnp.zeros((16, 5)), jnp.asarray(CENTERS), 0.8, 0.0, 4.0
    )
    static = forces.KernelPotential.with_zero_weights(CENTERS, 1.2)
    return random(forces.ChangingPotential(static, timed))


def structured():
    """Terms whose profiles follow each law, with kernels beside it or alone."""
    center, places = jnp.array([0.4, 0.9]), jnp.arange(0.5, 3.0, 0.5)
    both, alone = (jnp.linspace(0.9, -0.3, 6), places), (jnp.ones(1), jnp.zeros(0))
    hill, ended = FittedLaw("hill", (0.2, 0.7)), FittedLaw("hill", (0.5, -1.1))

    def central(weights, places, law):
        return forces.CentralTerm(weights, center, places, 0.6, law=law)

    def wall(angle, weights, places, law):
        return forces.WallTerm(weights, angle, center, places, 0.6, law=law)

    terms = (
        central(*both, hill),
        central(*alone, ended),
        central(*alone, FittedLaw("hill", (0.2, 0.0))),
        central(*alone, FittedLaw("plateau", (0.2, 0.6))),
        central(*both, FittedLaw("ring", (1.5, -0.2, 0.0))),
        central(both[0][1:], places, None),
        forces.EllipticTerm(
            both[0], center, jnp.array([0.2, -0.1]), places, 0.6, law=hill
        ),
        wall(0.6, *both, FittedLaw("step", (1.0, -0.2))),
        wall(0.6, *alone, FittedLaw("channel", (0.1, 0.9, -0.3))),
        wall(0.9, *both, FittedLaw("wave", (0.4, -0.3))),
        forces.LinearTerm(jnp.arange(5.0) / 9, center, 2.0),
    )
    free = forces.KernelPotential.with_zero_weights(CENTERS, 1.1)
    return forces.StructuredForce(terms, random(free))


LEARNED = {
    "kernel force": lambda: random(forces.KernelForce.with_zero_weights(CENTERS, 1.1)),
    "mixture": lambda: random(forces.KernelMixture.with_zero_weights(CENTERS, 1.1)),
    "changing potential": changing,
    "neural force": lambda: forces.NeuralForce(network(2), FEATURES, 1.7),
    "neural potential": lambda: forces.NeuralPotential(network(1), FEATURES, 1.7),
}


MEDIA = {
    "current": lambda: forces.InFlow(
        forces.TensorDrag(
            forces.UniaxialTensor(1.0, 2.0, forces.WavyDirector(0.3, 0.2, [0.4, 0.7]))
        ),
        forces.SumFlow(
            (forces.ShearFlow(0.3, 1.0), forces.PoiseuilleFlow(1.0, 1.0, 3.0))
        ),
    ),
    "sampled flow": lambda: forces.Advection(
        forces.SampledFlow(jnp.arange(3.0), jnp.arange(6.0).reshape(3, 2))
    ),
    "sheared drag": lambda: forces.TensorDrag(
        forces.CholeskyTensor.of(jnp.array([[2.0, 0.5], [0.5, 1.0]]))
    ),
}


def test_every_force_is_that_of_the_package():
    """Each class of force has an example in `FORCES`; none is refused."""
    entries = Entries()
    for name, make in {**FORCES, **MEDIA, "terms": structured}.items():
        force = make()
        entries.add(name, lambda t, x, v, force=force: force(t, x, v), {}, POINT)
    entries.check()


def test_derivatives_by_weights_are_those_of_the_package():
    entries = Entries()
    place = {name: POINT[name] for name in ("t", "x")}
    for name, make in LEARNED.items():
        force = make()
        arrays, fixed = eqx.partition(force.parameters, eqx.is_array)
        theta, unravel = jax.flatten_util.ravel_pytree(arrays)

        def at(theta, t, x, force=force, unravel=unravel, fixed=fixed):
            trained = eqx.combine(unravel(theta), fixed)
            moved = eqx.tree_at(lambda f: f.parameters, force, trained)
            return moved(t, x, jnp.zeros(2))

        entries.add(name, jax.jacrev(at), {"theta": theta}, place)
    entries.check(rtol=1e-8)


def test_commands_that_are_followed_late_are_those_of_the_package():
    rolling = forces.RollingPropulsion.of(2.0, 0.3, StepOutResponse(2.5))

    def thrust(lag, times, frequency, heading, t):
        late = eqx.tree_at(lambda p: (p.lag, p.delay), rolling, (lag, 0.1))
        commands = {"frequency": frequency, "heading": heading}
        return late.drive_by(times, commands)(t, jnp.zeros(2), jnp.zeros(2))

    times = jnp.minimum(jnp.arange(40.0) * 0.3, 9.0)  # padded by its last one
    early = {"lag": 0.2, "times": times, "frequency": 2 + jnp.sin(times)}
    entries = Entries()
    for t in (-1.0, 0.0, 3.31, 9.05, 30.0):
        entries.add(str(t), thrust, {**early, "heading": 0.1 * times}, {"t": t})
    entries.check()


def test_what_depends_on_parameters_alone_is_computed_once():
    def product(theta, t):
        return jnp.exp(jnp.sum(theta**2)) * t

    entries = Entries()
    program = entries.add("product", product, {"theta": jnp.arange(3.0)}, {"t": 2.0})
    entries.add("early", lambda theta: theta[::-1], {"theta": jnp.arange(3.0)}, {})
    entries.check()
    assert "Math.exp" not in program.text.partition("return")[2]
    assert program.inputs == {"theta", "t"}


def swarm(t, x):
    """The least of several distances, by an operation that is not printed."""
    distances = jnp.sort(jnp.linalg.norm(x[None] - jnp.asarray(CENTERS), axis=1))
    return distances[0] * jnp.stack([x[1], -jnp.sin(t) * x[0]])


class StrangeForce(forces.AbstractForce):
    def __call__(self, t, x, v):
        return swarm(t, x)


def test_a_force_that_is_not_printed_is_read_from_a_table():
    late = {name: POINT[name] for name in ("t", "x")}
    shapes = {name: np.shape(value) for name, value in late.items()}
    with pytest.raises(printing.UnknownPrimitive, match="sort"):
        printing.print_function(swarm, {}, shapes, printing.Constants(), RULES)
    hill = FORCES["barrier"]()
    table, error = tabulate(hill, TableBox((0.0, 0.0), (10.0, 10.0), (0.0, 2.0)))
    assert error < 1e-3
    entries = Entries()
    entries.add("table", lambda t, x: table(t, x, jnp.zeros(2)), {}, late)
    entries.check()
    np.testing.assert_allclose(table(*POINT.values()), hill(*POINT.values()), rtol=2e-3)


def test_a_table_follows_a_force_in_time():
    table, error = tabulate(
        FORCES["circling barrier"](), TableBox((0.0, 0.0), (10.0, 10.0), (3.0, 5.0))
    )
    assert table.table.values.shape[0] > 1
    assert error < 0.02
    away = TableBox((20.0, -5.0), (30.0, 5.0), (0.0, 1.0))
    lattice = tabulate(FORCES["barrier"](), away)[0].table.grid
    upper = lattice.lower + lattice.spacing * (np.array(lattice.shape) - 1)
    np.testing.assert_allclose(lattice.lower, [20 - 10 * MARGIN, -5 - 10 * MARGIN])
    np.testing.assert_allclose(upper, [30 + 10 * MARGIN, 5 + 10 * MARGIN])


RUNS = ("kernel", "positions", "langevin", "identified", "network", "reproduced")

ASK = """
  const run = JSON.parse(TEXT);
  const e = new Experiment(run);
  e.conditions = { ...firstConditions(run, e.isCommanded), kicks: 0 };
  const band = e.band();
  return {
    ...band, states: band.states.map((y) => [...y]), start: e.start(),
    draws: e.draws(2).map((states) => [...states.at(-1)]),
  };"""


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=[pytest.mark.slow] * (n != "kernel")) for n in RUNS]
)
def test_paths_and_bands_are_those_of_the_package(name, fitted_runs, tmp_path):
    run = Learned.open(fitted_runs.copy(name, tmp_path)[0])
    content = payload_of(run)
    programs = content.pop("programs")
    page = answer(ASK.replace("TEXT", json.dumps(script_json(content))), programs)
    start, times = np.array(page["start"]), np.array(page["times"])
    piece = list(run.data)[content["tracks"][0]["index"]]
    extent = content["extent"]
    first = run.models[content["models"][0]["name"]]
    path = rollout(drive_by_arrays(first, piece.times, piece.commands), start, times)
    error = np.abs(np.array(page["states"]) - np.asarray(path.ys))[:, :2]
    assert error.max() < BAR * extent
    if run.posterior is not None and "model" in run.models:
        sd, page_sd = band(run.posterior, piece, start, times), np.array(page["sd"])
        assert np.abs(1.96 * (page_sd - sd)).max() < BAR * extent
        np.testing.assert_allclose(page_sd, sd, rtol=0.05, atol=0.01 * sd.max())
        assert page["draws"][0] != page["draws"][1]


def band(posterior, piece, start, times):
    """Standard deviations of the positions, under the commands of a track."""

    def path(theta):
        model = drive_by_arrays(posterior.free(theta), piece.times, piece.commands)
        return rollout(model, start, times, solver=FixedStep()).ys

    rows = np.asarray(jax.jacfwd(path)(jnp.asarray(posterior.mean)))
    variances = np.einsum("tip,pq,tiq->ti", rows, posterior.covariance, rows)
    return np.sqrt(variances)[:, :2]
