"""What decides statistics of loops: chances, half widths, degrees of freedom, draws, each with its reason."""

from __future__ import annotations

from math import log, sqrt
from typing import NamedTuple


class Tolerances(NamedTuple):
    """Thresholds of the tests on loops; deviations of complex errors are sqrt E|d|² where nothing else is stated."""

    #: half a 95 % interval in deviations of 200 draws, Student's t of 199; 4 % more for the windows chosen from the
    #: same lines, which the draws do not repeat (experiments/margin_coverage)
    half_width_std: float = 1.04 * 1.972
    #: the same of the 40 draws of a shifted plant, Student's t of 39
    half_width_shifted_std: float = 2.02
    shifted_draws: int = 40
    #: a deviation of so many draws is itself known to 10 %, 1/sqrt(2 n)
    deviation_draws: int = 50
    #: half a 95 % interval of a normal error
    normal_95: float = 1.96
    #: |d|², which is exponential, and |d| of 95 % of a circular error, in its deviations
    square_95: float = -log(0.05)
    radius_95: float = sqrt(square_95)
    #: a count is not given where the chance that the lines' errors make it wrong is above this
    wrong_count: float = 0.005
    #: lines that scatter all along lie within so many of their deviations; one in 400 passes a point so far
    scatter_std: float = 2.0
    #: a place between lines that is known so many times worse than they are is a matter of finer lines
    uncertain_ratio: float = 1.5
    #: the peak of a pole 0.03 gaps wide is no more than so many times how far lines leave a polynomial
    unseen_peak: float = 33.0
    #: lines on either side of a gap, and order of the polynomial that a smooth plant follows over them
    window_lines: int = 5
    window_order: int = 3
    #: complex degrees of freedom that polynomial, residue and place of one pole leave of such a window
    window_freedom: int = 2 * window_lines - window_order - 3
    #: chance of a pole where there is none, over all gaps of a record; places and widths that are tried in one gap make
    #: so many independent tests
    pole_by_chance: float = 1e-3
    tests_per_gap: float = 3.0
    #: a residue so many deviations above the threshold is found in 99.9 % of cases: 3.1 of a real error
    found_std: float = 2.2
    #: how far from the best fit a pole is still allowed
    pole_radius_std: float = 3.0
    #: where noise alone is left one more pole must make it a hundred times less likely: ln of its chance
    one_more_pole: float = 4.6
    #: lines that a polynomial over many of them must leave, to tell scatter, of so many times their variance at most,
    #: from resonances
    scatter_freedom: int = 12
    scatter_variances: float = 50.0
    #: lines scatter all along where this share of the windows within so many gaps that share no line with a rough one
    #: leave more than noise, and in deviations this share of what the rough one leaves at least
    scatter_share: float = 0.75
    scatter_gaps: int = 60
    scatter_comparable: float = 0.1
    #: lines about which the median of five relative deviations is above this are too uncertain to be used
    poor_std: float = 0.15
    #: lines above the band, known to this share of their size at the end of their circle, tell what |L| is there
    known_above_std: float = 0.2
    #: those above it, and fits below it, count as known up to the first, and noise alone above the second
    known_beyond_std: float = 0.3
    noise_alone_std: float = 1.0
    #: slope and phase of the lowest lines that agree this well, in integrators, leave nothing to be seen below them;
    #: noise widens that to the second at most
    integrators_agree: float = 0.3
    integrators_agree_most: float = 0.75
    #: relative errors above the first, where |L| is above the second, leave nothing to read
    drowned_std: float = 0.7
    drowned_gain: float = 0.1
    #: an order of data is for an error so small that -1 lies this many deviations off if the estimate stays, and for so
    #: many times the data that would decide a limit
    ordered_clear_std: float = 4.0
    ordered_data: float = 4.0
    #: lines too uncertain are to be known to the first; more data do not help lines known as well as the second
    ordered_std: float = 0.05
    known_enough_std: float = 1e-4
    #: a change counts as noticed where it is found this often
    power: float = 0.8
    #: without a change of the plant's gain of this size being noticed so often no prediction is confirmed
    noticed_db: float = 1.0
    #: a band compared holds so many independent lines
    band_lines: float = 4.0
    #: degrees of freedom from which on a variance is known
    freedom_known: float = 1e6
    #: parts of a record that tell how it scatters, draws of noise beside it, and the ratio of both that noise hardly
    #: comes to: chi square of 23 degrees of freedom is 1.5 times its mean in 6 %
    record_parts: int = 24
    record_surrogates: int = 8
    bursts: float = 1.5
    #: the ratio from which on a record is unlike noise; so many of the largest parts tell how large it gets, and an
    #: event so many times as large as they let expect is one of its own
    unlike_noise: float = 3.0
    largest_parts: int = 6
    event_alone: float = 1.5


TOL = Tolerances()
