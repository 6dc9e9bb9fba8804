"""The paper's recipe on PyTorch and torchdiffeq, on the CPU.

Gradients by `odeint` with dopri5, which torchdiffeq's documentation allows for it;
`odeint_adjoint`, which saves memory, took 25 times as long here. One thread: two were
slower for matrices this small.
"""

import importlib
from typing import Any

from benchmarks.fit.contestants import Effort
from benchmarks.fit.problem import (
    Problem,
    Trained,
    network_arrays,
    paced,
    whole_recipe,
)

torch: Any = importlib.import_module("torch")
torchdiffeq: Any = importlib.import_module("torchdiffeq")


def untrained(seed: int):
    """The paper's network; PyTorch draws its weights as equinox does."""
    torch.manual_seed(seed)
    nn = torch.nn
    return nn.Sequential(
        nn.Linear(3, 32), nn.Tanh(), nn.Linear(32, 32), nn.Tanh(), nn.Linear(32, 2)
    )


def train(problem: Problem, seed: int, effort: Effort) -> Trained:
    """Adam at 0.01, then L-BFGS, in float32."""
    torch.set_num_threads(1)
    network = untrained(seed)
    times = torch.tensor(problem.times, dtype=torch.float32)
    states = torch.tensor(problem.states[0], dtype=torch.float32)
    thrust = torch.tensor(problem.thrust, dtype=torch.float32)

    def rate(t, y):
        x, v = y[:2], y[2:]
        force = network(torch.cat([x, t[None]]))
        return torch.cat([v, thrust - problem.damping * v + force])

    def closure():
        optimiser.zero_grad()
        ys = torchdiffeq.odeint(
            rate, states[0], times, method="dopri5", rtol=1e-6, atol=1e-6
        )
        loss = ((ys - states) ** 2).sum()
        loss.backward()
        return loss

    def step():
        return optimiser.step(closure)

    optimiser = torch.optim.Adam(network.parameters(), lr=1e-2)
    adam = paced(step, effort.adam_steps, seconds=effort.seconds)
    optimiser = torch.optim.LBFGS(
        network.parameters(), max_iter=1, history_size=10, line_search_fn="strong_wolfe"
    )
    lbfgs = paced(step, effort.lbfgs_steps, fraction=adam.fraction)
    iterations, full, note = whole_recipe([adam, lbfgs])
    layers = [layer for layer in network if hasattr(layer, "weight")]
    arrays = network_arrays(
        [(la.weight.detach().numpy(), la.bias.detach().numpy()) for la in layers]
    )
    return Trained(arrays, iterations, full_seconds=full, note=note)
