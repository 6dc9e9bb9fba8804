import numpy as np
from tests.fitting.structure.observed_forces import observed_forces

from pinav.fitting.structure.potential_map import PotentialMap
from pinav.forces import GaussianBarrier, LinearForce

POINTS = np.random.default_rng(1).uniform(0.0, 10.0, (1, 300, 2))


def test_a_hill_is_a_summit_whatever_linear_force_stands_beside_it():
    hill = GaussianBarrier(3.0, [4.0, 6.0], 1.0)
    saddle = LinearForce(np.array([[1.0, 0.5], [0.5, -1.0]]), [5.0, 5.0])
    data = observed_forces(hill + saddle, POINTS, 0.02)
    summits = PotentialMap.of(data).summits()
    np.testing.assert_allclose(summits[0], [4.0, 6.0], atol=0.5)
