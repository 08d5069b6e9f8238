"""What decides statistics of estimates: chances, degrees of freedom, windows, each with its reason."""

from __future__ import annotations

from typing import NamedTuple


class Tolerances(NamedTuple):
    """Thresholds of the tests on records and FRFs; deviations of complex errors are sqrt E|d|²."""

    #: degrees of freedom wanted of a variance: its own deviation is then 22 %, sqrt(2/n); fewer periods are pooled over
    #: neighbouring lines
    variance_freedom: int = 40
    #: a variance with fewer is pooled with its neighbours' where a decision rests on it
    decided_freedom: float = 60.0
    #: averages that longer segments must leave, and deviations of bias from which on they are worth their variance
    least_averages: float = 6.0
    bias_std: float = 2.0
    #: relative bias of H from which on a line counts as unresolved
    bias_seen: float = 0.02
    #: a band's distortion counts where noise alone gives as much in fewer than this share of cases
    distortion_by_chance: float = 1e-3
    #: one kind of distortion outweighs the other from here on
    distortion_clear_db: float = 3.0
    #: squared distance, in variances, up to which an estimate counts as equal: F(0.95) with many degrees of freedom
    equal_variances: float = 3.0
    #: fewer lines than this between doubtful ones, or beyond the last of them, are as doubtful
    island_lines: int = 25
    #: lines over which two estimates are compared, deviations beyond which one line by itself tells them apart, and the
    #: relative deviation up to which so many lines tell 10 %
    alongside_lines: int = 9
    alone_std: float = 3.0
    alongside_std: float = 0.15
    #: share of an output's unexplained power that its input's future explains, from which on the input may be it
    before_its_cause: float = 0.5
    #: share of an output's residual that a sweep's future explains where it is feedback: without, up to 15 % in 600
    #: records whose input's sensor has noise, which makes a sweep less predictable; where more than the second of the
    #: sweep's power is left without what follows from it, that is no sensor's noise and the third will do
    feedback_share: float = 0.15
    feedback_noisy: float = 0.01
    feedback_share_noisy: float = 0.05
    #: a smoothing window is too wide where the residual of degree 2 exceeds the noise by so many deviations, and a
    #: line's is the median of so many lines': one line's bad luck does not narrow it alone
    smooth_std: float = 6.0
    smooth_lines: int = 11
    #: chance that all windows of noise alone leave one out when frequencies are merged; variances of merged neighbours
    #: differ by this factor at most
    merged_by_chance: float = 1e-3
    merged_ratio: float = 4.0
    #: a resonance's residue is so many deviations large, its frequency and damping known to this share of the half
    #: width, or its frequency alone to this share of a gap
    resonance_std: float = 6.0
    resonance_known: float = 0.25
    resonance_placed: float = 0.15
    #: lines' worth of stated noise that what a window leaves over is added to
    prior_lines: float = 4.0
    #: misfit that noise leaves at most in 99.9 % of windows; more is rounding off, and counts so many times
    noise_misfit: float = 3.3
    rounding_counts: float = 10.0
    #: difference of Schwarz's criterion that is very strong evidence for the richer model (Kass and Raftery 1995)
    very_strong: float = 10.0
    #: chi²/dof below which what is left of a fit is rounding and no noise of the stated variance
    no_noise: float = 1e-6
    #: share of the frequencies from which on loop noise above the excitation is reported; fewer lie at its ends
    drowned_share: float = 0.1
    #: relative deviation of a plant input's answer from which on its quotient is not used: its bias is the square
    drowned_std: float = 0.3
    #: lines known worse than this show their own noise and not how far a fit lies off (the valid band bridges as much)
    misfit_std: float = 0.3
    #: relative deviation up to which a control is compared with its controller's answer
    known_control_std: float = 0.1
    #: complex degrees of freedom that a local window must leave to its noise
    local_freedom: int = 6
    #: the narrowest window counts that predicts worse than the best by no more than the first, in ln of power; a
    #: denominator bends towards noise, which no variance shows, and must pay by the second
    as_good_ln: float = 0.01
    poles_pay_ln: float = 0.1
    #: of sweeps: squared distance from a narrower window's answer, over what noise gives, from which on one is too
    #: wide; the steps by which the one that is taken is narrower, and the narrowest one
    sweep_misfit: float = 1.5
    sweep_narrower: int = 4
    sweep_narrowest: int = 2
    #: share of the polynomial's variance below which a rational is taken
    rational_pays: float = 0.5
    #: variance that a transient may add before its lines count as inseparable from it, and up to which a denominator is
    #: fitted beside it
    transient_variance: float = 2.0
    transient_beside: float = 1.02
    #: lines on each side over which windows are chosen together, and over which a line's noise is pooled
    choice_pooled: int = 3
    noise_pooled: int = 5
    #: of a quadratic's kernel, the integral of its squared correlation: lines of one line's worth of independent error
    sweep_overlap: float = 0.7
    #: a harmonic is taken that explains so many times what noise would, if all those taken leave this share at most;
    #: one that the sweep explains beyond the third passes with it, and a machine has it in the fourth of the windows
    harmonic_clear: float = 5.0
    harmonic_leaves: float = 0.67
    harmonic_apart: float = 0.5
    harmonic_often: float = 0.2


TOL = Tolerances()
