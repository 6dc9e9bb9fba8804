"""The client of a sweep: hands out what is not done, and once more what is lost."""

from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, wait

import msgspec
from tqdm import tqdm

from pinav import __version__
from pinav.errors import InputError
from pinav.sweeps.attempt import Answer, Order, process_name
from pinav.sweeps.cell import Cell, Outcome
from pinav.sweeps.engines import AbstractEngine
from pinav.sweeps.store import CellStore

KILLS = 10
"""Workers that may be killed from outside while they do one cell."""

PAUSE = 0.5
"""How often a client looks for new workers [s]."""


def run_sweep(
    cells: Sequence[Cell],
    store: CellStore,
    engine: AbstractEngine,
    *,
    timeout: float | None = None,
    title: str = "cells",
    on_done: Callable[[Cell, Outcome], None] = lambda cell, outcome: None,
) -> list[Outcome]:
    """Do every cell once; those that the store holds are done.

    The caller holds the folder (`claim`), and closes the engine.

    Args:
        cells: the table.
        store: where their folders are.
        engine: who does them.
        timeout: seconds that a cell may take.
        title: of the progress bar.
        on_done: told of each cell when it is done now.

    Returns:
        One outcome for each cell, in the order of the table.

    Raises:
        InputError: workers cannot do anything, such as for want of disk.
        OSError: the folder cannot be written.
    """
    sweep = _Sweep(cells, store, engine, timeout)
    with tqdm(
        total=len(cells),
        initial=len(cells) - len(sweep.waiting),
        desc=title,
        unit="cell",
        dynamic_ncols=True,
    ) as bar:
        while sweep.waiting or sweep.running:
            sweep.hand_out()
            for cell, outcome in sweep.collect():
                bar.set_postfix_str(cell.label, refresh=False)
                bar.update()
                on_done(cell, outcome)
    outcomes = [store.outcome(cell) for cell in cells]
    return [outcome for outcome in outcomes if outcome is not None]


class _Sweep:
    """What waits and what runs."""

    def __init__(
        self,
        cells: Sequence[Cell],
        store: CellStore,
        engine: AbstractEngine,
        timeout: float | None,
    ) -> None:
        self.store, self.engine, self.timeout = store, engine, timeout
        self.token = store.write_plan(cells, engine.description).token
        self.waiting = [cell for cell in dict.fromkeys(cells) if self._is_undone(cell)]
        self.running: dict[Future[str], tuple[str, Cell]] = {}
        self.shapes: dict[str, str] = {}
        self.deaths: Counter[Cell] = Counter()

    def _is_undone(self, cell: Cell) -> bool:
        """Whether a cell is to be done; attempts of a client that died do not count."""
        outcome = self.store.outcome(cell)
        self.store.forget(cell)
        if outcome is not None and outcome.again:
            self.store.discard(cell)
        return outcome is None or outcome.again

    def hand_out(self) -> None:
        """Give each free worker a cell."""
        busy = {place for place, _ in self.running.values()}
        for place in self.engine.places():
            if place not in busy and self.waiting:
                cell = self.waiting.pop(self._choose(place))
                self.shapes[place] = cell.shape
                future = self.engine.submit(place, __version__, self._order(cell))
                self.running[future] = place, cell

    def _choose(self, place: str) -> int:
        """A cell of the shape that the worker has compiled, else of one nobody has."""
        mine = self.shapes.get(place)
        others = {shape for where, shape in self.shapes.items() if where != place}
        shapes = [cell.shape for cell in self.waiting]
        if mine in shapes:
            return shapes.index(mine)
        new = (index for index, shape in enumerate(shapes) if shape not in others)
        return next(new, 0)

    def _order(self, cell: Cell) -> str:
        order = Order(
            cells=str(self.store.path.absolute()),
            token=self.token,
            cell=cell.text,
            client=process_name(),
            timeout=self.timeout,
        )
        return msgspec.json.encode(order).decode()

    def collect(self) -> list[tuple[Cell, Outcome]]:
        """Wait a little; the cells that are done since."""
        if not self.running:
            wait([Future()], timeout=PAUSE)  # for a worker to come
        done, _ = wait(self.running, timeout=PAUSE, return_when=FIRST_COMPLETED)
        results = []
        for future in done:
            _, cell = self.running.pop(future)
            outcome = self._settle(future, cell)
            if outcome is None:
                self.waiting.append(cell)  # last: others need not wait for its crashes
            else:
                results.append((cell, outcome))
        return results

    def _settle(self, future: Future[str], cell: Cell) -> Outcome | None:
        """What became of a cell; none where its worker was lost.

        Raises:
            InputError: the workers cannot do anything.
        """
        try:
            answer = msgspec.json.decode(future.result(), type=Answer)
        except Exception as error:
            death = self.engine.check_death(error)
        else:
            if answer.refusal:
                raise InputError(f"{answer.refusal}; then continue with --resume")
            return self.store.wait_for(cell)
        self.deaths[cell] += 1
        if self.deaths[cell] >= KILLS:
            return self._give_up(cell)
        if death.killed:
            self.store.forget(cell, death.pid)
        return None

    def _give_up(self, cell: Cell) -> Outcome:
        outcome = Outcome(0.0, f"its worker was killed {KILLS} times", again=True)
        attempt = self.store.begin(cell)
        self.store.publish(cell, attempt, outcome)
        self.store.forget(cell)
        return outcome
