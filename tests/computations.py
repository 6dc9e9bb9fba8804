"""Small computations of the library whose numbers are kept (tests/stored_numbers.py).

Each function of `COMPUTATIONS` takes no argument. All numbers of its value are kept:
of arrays, and of the structures that hold them. Names begin with the package.
"""

import copy
import dataclasses
import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from tests.analysis.sensitivity import test_sobol as sobol
from tests.evaluation import test_process_noise as wander
from tests.fitting.environments import test_gradient_matching as rates
from tests.fitting.evidence import test_evidence as weights
from tests.fitting.evidence import test_hyperparameter_uncertainty as shapes
from tests.fitting.evidence import test_model_evidence as priors
from tests.fitting.langevin import test_known_laws as thermal
from tests.fitting.matching import test_fit as matching
from tests.fitting.problems import in_a_trap, quadratic_of
from tests.fitting.rugged import test_hills as rugged
from tests.fitting.structure import test_laws as laws
from tests.fitting.structure import test_moves as moves
from tests.fitting.structure import test_rotation as rotation
from tests.fitting.structure import test_scan as scan
from tests.fitting.structure import test_search as search
from tests.forces.examples import FORCES, KEY, TENSORS, TERMS, T, V, X
from tests.forces.test_priors import LEARNED, STILL
from tests.identification import test_kalman as kalman
from tests.identification.running.test_running_fit import run as run_drive
from tests.identification.running.test_running_fit import small_grid
from tests.live import test_safety as safety
from tests.live.sessions import HELLO
from tests.navigation import steering_worlds as worlds
from tests.navigation.adaptive import test_adaptive as adapting
from tests.navigation.belief import test_belief as beliefs
from tests.navigation.control.test_control import METHODS, aim
from tests.navigation.design import test_campaign as campaigns
from tests.thermal import test_solve as bodies
from tests.trajectories import test_degradation as degraded
from validation.heat.checks import AMPLITUDE, reference_model

from pinav import actuation, analysis, evaluation, fitting, navigation
from pinav.dynamics import Swimmer
from pinav.evaluation.coverage import wandering_variance
from pinav.fitting import LearnedObservation
from pinav.fitting.structure.starts import central_term, wall_term
from pinav.forces import (
    KernelAxis,
    LinearDrag,
    StructuredForce,
    ZeroForce,
    ring_barrier,
    soft_wall,
)
from pinav.identification.running import RunningFit
from pinav.identification.running.forecast import estimate, forecast, gain_at, locate
from pinav.live.estimators import DriveEstimator
from pinav.live.messages import Frame
from pinav.live.roller_pilot import RollerPilot
from pinav.navigation.adaptive.steering import AdaptiveController
from pinav.navigation.control.controller import Observation
from pinav.navigation.design.campaign import decide
from pinav.navigation.design.candidates import GridDesign, RandomDesign
from pinav.navigation.task.catalogue import TASKS
from pinav.navigation.task.steering import all_directions
from pinav.navigation.task.task import Disc
from pinav.navigation.trials import metrics
from pinav.navigation.trials.closed_loop import run, run_many
from pinav.scenarios import SCENARIOS, scenario
from pinav.thermal.boundaries import Robin, outer
from pinav.thermal.dose import LIVER_DAMAGE, SKIN_DAMAGE, cem43_segment
from pinav.thermal.grids import CartesianGrid, RadialGrid
from pinav.thermal.perfusion import (
    LANG,
    RegionalPerfusion,
    kernel_perfusion,
    lang,
    neural_perfusion,
)
from pinav.thermal.protocols import Piecewise
from pinav.thermal.solve import solve
from pinav.thermal.sources import LinearResponse, LogNormalSizes, eddy_power
from pinav.thermal.starts import find_steady_state
from pinav.thermal.steppers import Rosenbrock
from pinav.thermal.tissues import PRESETS, Blood, mix, preset
from pinav.trajectories import degrade, simulate

COMPUTATIONS: dict[str, Callable[[], Any]] = {}


def kept(function: Callable[[], Any]) -> Callable[[], Any]:
    """Keep the numbers of what a function returns."""
    COMPUTATIONS[function.__name__.replace("_", "-")] = function
    return function


@kept
def forces() -> Any:
    """Each force at a place, its potential where it has one, and tensors."""
    made = {name: make() for name, make in FORCES.items()}
    potentials = {
        name: force.potential(T, X)
        for name, force in made.items()
        if hasattr(force, "potential") and name not in {"law", "sum", "swirl"}
    }
    found = {name: force(T, X, V) for name, force in made.items()}
    return found, potentials, {name: make()(X, V) for name, make in TENSORS.items()}


@kept
def scenarios() -> Any:
    """The starts, times and slopes of every built-in system, and its numbers."""
    systems = [scenario(name, KEY) for name in SCENARIOS]
    return {own.name: (own, own.truth(own.times[1], own.starts[0])) for own in systems}


@kept
def thermal_motion() -> Any:
    """Two short tracks of Brownian motion, as they are simulated."""
    system = scenario("brownian", jax.random.key(1), count=2)
    short = dataclasses.replace(system, times=system.times[:6])
    return simulate(short, key=jax.random.key(2)).states


def described(proposals: Any) -> Any:
    """What is known of terms that were tried."""
    return [(one.log_evidence, one.noise, one.terms) for one in proposals]


@kept
def structure_search() -> Any:
    """All terms that the search tries for a hill on a saddle."""
    return described(search.search(search.HILL + search.SADDLE).run())


@kept
def structure_moves() -> Any:
    """Terms before and after they are moved together."""
    before, after = moves.placed(moves.NEAR), moves.move(moves.NEAR, moves.DATA)
    return [(one.log_evidence, one.ratio, one.terms) for one in (before, after)]


@kept
def structure_scan() -> Any:
    """The quick evidence of single terms and of pairs."""
    one = scan.Scanned(scan.HILL + scan.WALL)
    beside = one.held.beside(one.walls), one.held.beside(one.centres)
    prices = one.walls.price, one.centres.price
    return *beside, one.held.pairs(one.walls, one.centres), *prices


@kept
def structure_rotation() -> Any:
    """The gain of a rotational part where the force turns, and where not."""
    truths = rotation.PULL, rotation.PULL + rotation.SWIRL
    places = rotation.KERNELS
    return [
        rotation.survey_rotation(rotation.response(truth), 0.05, (), places)
        for truth in truths
    ]


@kept
def rugged_hills() -> Any:
    """Hills and wells that are proposed about free kernels."""
    return rugged.hills_of(rugged.SumForce(rugged.BARRIERS))


@functools.cache
def linear_data() -> Any:
    """A linear model whose flat parameters are integrated out."""
    rng = np.random.default_rng(1)
    design = rng.normal(size=(30, 6))
    data = design @ weights.TRUE + 0.1 * rng.normal(size=30)
    quadratic = quadratic_of(design, data, rng.normal(size=6))
    return quadratic, weights.eliminate_flat(quadratic, weights.MASK)


@kept
def evidence_of_weights() -> Any:
    """Hyperparameters, weights and their joint posterior with the flat ones."""
    quadratic, (reduced, *rest) = linear_data()
    data, prior = weights.LinearisedObservations.of(reduced), weights.Correlated()
    found = []
    for noise in (None, 0.3):
        chosen = weights.best_hyperparameters(data, prior, np.zeros(1), noise)
        posterior = weights.weight_posterior(
            data, prior.covariance(chosen.shape), chosen
        )
        white = weights.Whitened.of(data, prior.covariance(np.full(1, 0.4)))
        slope = weights.shape_slope(data, white, chosen, prior)
        found.append((chosen, posterior, slope))
    scales = weights.evidence_of_scales(data, prior.covariance(np.full(1, 0.4)))
    return found, reduced, rest, quadratic, scales(0.7, 0.2)


@kept
def evidence_over_shapes() -> Any:
    """Weights over all shapes of their prior, in the middle and at its edge."""
    found = []
    for second in (0.05, 0.5, 3.0):
        data, prior = shapes.data(second), shapes.Tilt()
        chosen = shapes.best_hyperparameters(data, prior, np.zeros(1), 0.2)
        found.append((chosen, shapes.mix_shapes(data, prior, chosen)))
    return found


@kept
def priors_of_kernels() -> Any:
    """Covariances of weights, their slopes, and the evidence of random data."""
    found = {}
    for name, environment in priors.ENVIRONMENTS.items():
        prior, rng = environment.prior(), np.random.default_rng(4)
        shape = prior.start + rng.uniform(-0.3, 0.3, size=len(prior.start))
        covariance = prior.covariance(shape)
        pull = rng.normal(size=covariance.shape)
        design = rng.normal(size=(60, len(covariance)))
        data = priors.LinearisedObservations.of(
            quadratic_of(design, design @ rng.normal(size=len(covariance)))
        )
        fit = priors.at_shape(data, prior.covariance, shape, 0.1)
        values = covariance, prior.pullback(shape, pull + pull.T), prior.bounds, fit
        found[name] = values
    return found


@kept
def drives_of_tracks() -> Any:
    """The likelihood of tracks whose velocity and gain wander."""
    known = kalman.disturbance(gain_wander=0.5)
    turned = jax.random.normal(jax.random.key(2), (6,), complex)
    steps = kalman.steps_of(known, 0.7, cycles=turned)
    columns = jax.random.normal(jax.random.key(0), (7, 2), complex)
    begins = kalman.FIRST.at[3].set(1.0)
    found = kalman.innovations(columns, jnp.ones(7), begins, steps, known.noise)
    complex_parts = found.columns, steps.matrix, steps.noise
    parts = [(part.real, part.imag) for part in complex_parts]
    return parts, found.log_variance, known.wandering.strength(jnp.arange(4.0))


@functools.cache
def drive() -> Any:
    """A drive after a while, and its robot."""
    return run_drive(RunningFit.begin(small_grid()), 60)


@kept
def running_drive() -> Any:
    """What is known of a drive after six seconds, and where it leads."""
    fit, robot = drive()
    times, commands = robot.t + 0.2 * np.arange(6), np.linspace(0.5, 3.0, 6)
    ahead = forecast(fit, times, commands, np.linspace(0.0, 2.0, 6))
    place = locate(fit, robot.t + 0.1)
    gain = gain_at(fit, 1.5)
    return estimate(fit), ahead, place, gain, fit.bank


@kept
def live_safety() -> Any:
    """Verdicts on commands towards a disc and past it."""
    fit, robot = drive()
    known = fit.after(robot.t, robot.seen(), 0.0, 0.0), robot
    views = [safety.outlook(known, (x, 14.0, 10.0)) for x in (0.0, 8.0)]
    angles = np.array([0.3, 1.5, 2.8])
    return [
        (view.judge(safety.towards(angle), safety.Reserve()), tube(view, angle))
        for view in views
        for angle in angles
    ]


def tube(view: Any, angle: float) -> Any:
    """Distances of the tube of a command that is held."""
    order = safety.towards(angle)
    return view.clearances(order, order, 2.0)


@kept
def live_pilot() -> Any:
    """What a pilot advises about a robot that it knows, with a disc in the way."""
    fit, robot = copy.deepcopy(drive())
    discs, advice = np.array([[robot.x + 20.0, robot.y + 4.0, 9.0]]), []
    goal, probed = np.array([robot.x + 45.0, robot.y + 8.0]), np.array([9.0, 0.0])
    pilot, estimator = RollerPilot(goal, 3.0, discs, probed), DriveEstimator(fit)
    for seq in range(6):
        pilot, given = pilot.after(estimator, HELLO, robot.t)
        advice.append((given.frequency, given.heading, given.time_to_go))
        robot.move(given.frequency, given.heading)
        seen = dict(zip("xy", robot.seen(), strict=True))
        order = {"frequency": given.frequency, "heading": given.heading}
        estimator = estimator.after(Frame(seq=seq, t=robot.t, **seen, **order))
    return advice, pilot, estimator.whereabouts(robot.t + 0.1)


@kept
def plans() -> Any:
    """Times to go in a drift, about a disc, to a path, and with inertia."""
    drift, disc = (0.4, -0.3), Disc([0.25, 0.25], 1.0)
    rolling = worlds.rolling(Swimmer(ZeroForce(), LinearDrag(0.3), ZeroForce()))
    start = (-2.0, 1.5, 0.0, 0.0)
    made = [
        worlds.planned(worlds.swimming(drift), points=21),
        worlds.planned(worlds.swimming(drift, keep_out=(disc,)), points=21),
        worlds.planned(worlds.swimming((0.2, 0.0, 0.1)), points=9),
        worlds.planned(worlds.swimming(truth=rolling, start=start), points=9, speeds=5),
    ]
    routes = [plan.route(worlds.swimming(drift).start) for plan in made[:2]]
    return [(plan.values, plan.map) for plan in made], routes


@kept
def controls() -> Any:
    """The first decision of both methods of predictive control, and its cost."""
    prediction, cost = aim()
    seen = Observation(jnp.zeros(()), jnp.asarray(worlds.START[2]), jnp.zeros((1, 2)))
    found = {}
    for name, make in METHODS.items():
        method = make(prediction, cost)
        decided = method(seen, method.start(seen), key=jax.random.key(0))
        found[name] = decided, cost(*prediction(seen, decided[1]), decided[1])
    return found


@kept
def closed_loops() -> Any:
    """Episodes with a delay, noise and a disc, and what is told of them."""
    disc = Disc([1.0, 0.4], 0.3)
    task = worlds.open_water(delay=0.25, noise=0.2, sensor_noise=0.1, keep_out=(disc,))
    swum = run(task, worlds.AHEAD, key=jax.random.key(3))
    inert = worlds.open_water(inert=True, noise=0.1, start=(0.0, 0.0, 0.5, 0.2))
    many = run_many(task, worlds.AHEAD, jax.random.split(jax.random.key(1), 4))
    turned = run(inert, worlds.ASIDE, key=jax.random.key(4))
    clockless = {"compute": np.zeros(0)}
    runs = [dataclasses.replace(one, **clockless) for one in (swum, turned, many)]
    return runs, metrics.summary(many, task)


@kept
def tasks() -> Any:
    """Each task of the catalogue: its numbers, and the rate of its truth."""
    found = {}
    for name in TASKS:
        task = navigation.task(name)
        command = jnp.append(
            0.7 * task.limits.max_frequency, jnp.full(task.dim - 1, 0.4)
        )
        found[name] = task, task.truth(0.3, task.start, command)
    return found, all_directions(5, 3)


@kept
def beliefs_of_force() -> Any:
    """What is believed after ten frames of a flight, with and without inertia."""
    places = np.linspace([1.0, 2.0], [6.0, 3.0], 4)
    believed = [beliefs.flown(10, motion) for motion in beliefs.MOTIONS.values()]
    return [
        (one.state, one.force(places), one.log_evidence, one.leader) for one in believed
    ]


@functools.cache
def adaptive() -> Any:
    """A controller that learns in a vortex, and its belief after a straight flight."""
    controller = AdaptiveController.of(worlds.vortex(), points=13)
    return controller, adapting.straight_on(controller)


@kept
def strategies() -> Any:
    """Tables of what is believed, hoped for and explored, and a plan on them."""
    controller, belief = adaptive()
    found = {}
    for name, strategy in adapting.STRATEGIES.items():
        tables = strategy.tables(belief, controller.physics, controller.thrust)
        prices = [tables.time_cost.running_cost(0.0, x) for x in jnp.eye(2) * 5 + 2]
        found[name] = tables.table.values, tables.time_cost, jnp.stack(prices)
    return found, controller.replanner.plan(controller.physics, sweeps=2).values


@kept
def safety_of_commands() -> Any:
    """Verdicts on full thrust towards a disc, in still water and in a current."""
    controller, _ = adaptive()
    cases = (4.93, 0.0, (0.0, 0.0)), (4.93, 2.5, (0.3, 0.2)), (4.82, 0.0, (0.6, 0.0))
    return [adapting.safety_case(controller, *case) for case in cases]


@kept
def designs() -> Any:
    """What a campaign would decide, draw, record, learn and expect."""
    controller, belief = adaptive()
    experiment, key = campaigns.experiment_of(controller.task), campaigns.KEY
    stage = campaigns.Stage(controller, experiment, belief, campaigns.WAY, 3)
    drawn = experiment.draw(3, key=key)
    chosen = [kind().choose(stage, key=key) for kind in (GridDesign, RandomDesign)]
    frames, path = campaigns.record(experiment, drawn[0], key=key)
    later = campaigns.learn(controller, belief, frames)
    expected = [campaigns.expected_sd(stage, one) for one in chosen]
    varied, decision = experiment.vary(drawn[0], 2, key=key), decide(controller, later)
    return decision, drawn, varied, chosen, path, later.force(campaigns.WAY), expected


TEMPERATURES = jnp.array([30.0, 37.2, 39.5, 41.3, 42.9, 43.4, 45.1, 52.0])


@kept
def heat_of_tissue() -> Any:
    """Laws of perfusion, presets of tissues, dose and damage."""
    laws = {name: lang(name)(TEMPERATURES) for name in LANG}
    curves = [
        make(0.47, (37.0, 46.0))(TEMPERATURES)
        for make in (kernel_perfusion, functools.partial(neural_perfusion, key=KEY))
    ]
    dose = cem43_segment(TEMPERATURES[:-1], TEMPERATURES[1:], 40.0)
    damage = [law.rate(TEMPERATURES) for law in (SKIN_DAMAGE, LIVER_DAMAGE)]
    share = jnp.linspace(0.0, 1.0, 8)
    both = mix([share, 1 - share], [preset("fat").tissue, preset("muscle").tissue])
    return laws, curves, dose, damage, both, PRESETS, Blood()


@kept
def heat_of_particles() -> Any:
    """Power of particles of one size and of many, of eddies, and limits of fields."""
    fields = (2e3, 1e5), (3e4, 4e5)
    one = LinearResponse(12e-9)
    many = LogNormalSizes(one, 0.1)
    eddies = eddy_power(0.05, 0.4, 2e9)
    ball = RadialGrid.sphere(0.04, 12)
    powers = [kind.slp(*field) for kind in (one, many) for field in fields]
    return powers, eddies, one, ball.ball(0.011)


@kept
def steady_heat() -> Any:
    """Steady states of a ball and of a slab with sides, and a run of a few steps."""
    grid = RadialGrid.sphere(0.04, 16)
    share = grid.ball(0.01)
    law = RegionalPerfusion((share, 1 - share), (lang("tumour"), lang("muscle")))
    ball = reference_model(grid, 1.2e5 * share, outer(Robin(20.0, 25.0)), law)
    steps = Piecewise.constant((0.0, 100.0, 200.0), [1e4, 5e3], 1e5)
    heated = solve(ball, steps, stepper=Rosenbrock(20.0), save_every=50.0)
    return find_steady_state(ball, AMPLITUDE), heated


@kept
def fitted_paths() -> Any:
    """Two steps of Gauss and Newton on windows, of a network of a force."""
    data = matching.observe([[-1.0, 0.0, 1.5, 0.1]], [12])
    phases = (fitting.GaussNewton(4, target=1e-9, steps=2),)
    model = matching.network_swimmer(0)
    found = fitting.fit(model, data, phases, **matching.EXACTLY)
    return found.losses, found.model.environment


@kept
def langevin_field() -> Any:
    """Drift and diffusion along a line: a diffusion that varies; blur and error."""
    rng, times = np.random.default_rng(0), 0.05 * np.arange(80)
    path = in_a_trap(rng, times, (4, 1), 1.0, 0.5).swapaxes(0, 1)
    data, axis = thermal.tracks(times, path), KernelAxis(0)
    field, camera = fitting.KernelDiffusion((axis,), across=4), LearnedObservation()
    return [
        (fit.thermal, fit.hyperparameters, fit.model.environment)
        for fit in (
            thermal.path_of(data, axis, across=4, diffusion=field),
            thermal.path_of(data, axis, across=4, observation=camera),
        )
    ]


@kept
def priors_of_forces() -> Any:
    """Covariances of the weights of all learned forces, and their slopes."""
    found = {}
    beside = {name: StructuredForce((make(),), STILL) for name, make in TERMS.items()}
    for name, force in (LEARNED | beside).items():
        prior = force.prior()
        covariance = prior.covariance(prior.start + 0.1)
        pull = np.cos(np.arange(covariance.size)).reshape(covariance.shape)
        slopes = prior.pullback(prior.start + 0.1, pull + pull.T)
        found[name] = covariance, slopes, prior.start, prior.bounds
    return found


@kept
def matched_kernels() -> Any:
    """Rates along a path, the force that they leave, its region, and its kernels."""
    data, truth = rates.observe(rates.TRUTH), rates.TRUTH
    observed = rates.rates_of(data)
    left = rates.residual_forces(truth.without_environment(), observed)
    region = rates.force_region(observed, left)
    environment = rates.match_kernels(truth, observed)
    force = evaluation.exact_forces(environment, observed.states[::5, :2])
    return observed, left, region, force, environment.width


@kept
def worsened_data() -> Any:
    """Data with noise, blur and losses; what each response makes of frequencies."""
    data, steps = degraded.smooth(2, 12), degraded.STEPS.items()
    worse = [(name, degrade(data, [step], key=KEY)) for name, step in steps]
    kinds = actuation.SaturatingResponse(3.0), actuation.SlippingResponse(2.0, 0.3)
    asked = jnp.array([0.5, 2.0, 2.6, 7.0])
    answers = [kind(asked) for kind in (*kinds, actuation.StepOutResponse(2.2))]
    return {name: (one.states, one.observed) for name, one in worse}, answers


@kept
def doubt_of_rollouts() -> Any:
    """Variance of a wandering swimmer, whiteness, and bands that are calibrated."""
    piece = next(iter(wander.recording(wander.paths(1, wander.TIMES, 0), wander.TIMES)))
    mean, swimmer = 0.9 * piece.states, wander.model()
    variance = wandering_variance(swimmer, wander.WANDERING, piece, mean, 5)
    series = np.cos(np.arange(40.0) ** 2).reshape(1, 20, 2)
    white = evaluation.whiteness(series, np.ones((1, 20, 2), bool), ("x", "y"), 4)
    scores = evaluation.calibrate(np.arange(1.0, 40.0) ** 2, 0.1)
    return variance, white, scores, evaluation.normal_quantile(0.9)


@kept
def heat_in_the_plane() -> Any:
    """A tumour in muscle, with eddies and a film: its energy and its temperatures."""
    found = []
    for grid in (CartesianGrid.cubes((8, 6), 4e-3), RadialGrid.cylinder(0.03, 12)):
        model = bodies.heated_tumour(grid, Robin(15.0, 25.0))
        protocol = Piecewise.ramp((0, 60, 120), [0.0, 1.1e4, 0.9e4], 1e5)
        run = solve(model, protocol)
        found.append((run.final.temperature, run.energy, grid.volumes))
    plane = CartesianGrid.cubes((8, 6), 4e-3)
    return found, plane.ball(0.006, center=(0.013, 0.011))


@kept
def structure_laws() -> Any:
    """The law that the profile of a ring follows, and the one of a wall."""
    ring, wall = ring_barrier(2.0, laws.CENTER, 3.0, 0.8), soft_wall(4.0, 0.7, 7.0, 0.8)
    start = central_term(laws.REGION, np.array([4.0, 6.0]))
    begun = start, wall_term(laws.REGION, 0.7)
    return [laws.lawful(*pair) for pair in zip((ring, wall), begun, strict=True)]


@kept
def sensitivity() -> Any:
    """Sobol' indices of a closed form, and a spectrum of residuals."""
    factors = [analysis.Factor(f"x{i}", -np.pi, np.pi) for i in range(3)]
    return analysis.sobol_indices(sobol.ishigami, factors, ["y"], samples=64)
