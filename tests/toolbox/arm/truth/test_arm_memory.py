"""A batch of arms needs the memory of its recordings and little more."""

import tracemalloc


def test_peak_memory_of_a_batch_is_its_recordings(arm, arm_experiment):
    seconds, count = 20, 6
    experiments = [arm_experiment((0.0, 1.0), 1000 * seconds) for _ in range(count)]
    arm.simulate(experiments[:1])  # compile outside the measurement
    tracemalloc.start()
    recordings = arm.simulate(experiments, threads=2)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    own = {"t_s", "z_theta2_v", "theta2_rad", "z_p_v", "p_a_bar", "p_b_bar", "u_a_v", "u_b_v"}
    recorded = sum(r.columns[name].nbytes for r in recordings for name in own)
    # beside them: raw pressures in Pa of each log (2 of 7 columns) and working copies of two arms' references
    working = 2 * experiments[0].references.nbytes
    assert peak < recorded * (1 + 2 / 8) + working + 2e5
