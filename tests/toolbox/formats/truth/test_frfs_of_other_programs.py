"""FRFs in tables of analysers and simulators read as the response that they were written from."""

import numpy as np
import pytest

import loopshape as ls

F = np.geomspace(10.0, 1e4, 30)
H = 100.0 / (1.0 + 1j * F / 50.0) * np.exp(-2j * np.pi * F * 2e-4)  # more than a turn
DB = 20.0 * np.log10(np.abs(H))
WRAPPED = np.degrees(np.angle(H))
UNWRAPPED = np.degrees(np.unwrap(np.angle(H)))


def rows(*columns, separator=",", decimal="."):
    lines = (separator.join(f"{v!r}" for v in map(float, row)) for row in zip(*columns, strict=True))
    return "\n".join(line.replace(".", decimal) for line in lines) + "\n"


BODE_100 = (
    "Device,Bode 100\nDate,2024-03-05 10:11:12\nReceiver bandwidth,30 Hz\n\n"
    "Frequency (Hz),Trace 1: Gain: Magnitude (dB),Trace 1: Gain: Phase (°),Trace 2: Gain: Magnitude (dB)\n"
)
TABLES = {
    "degrees.csv": "Frequency (Hz),Magnitude (dB),Phase (deg)\n" + rows(F, DB, WRAPPED),
    "unwrapped.csv": "Frequency (Hz),Magnitude (dB),Phase (deg)\n" + rows(F, DB, UNWRAPPED),
    "khz.csv": "freq [kHz],gain [dB],phase [rad]\n" + rows(F / 1e3, DB, np.radians(WRAPPED)),
    "ratio.csv": "freq_hz,gain (abs),phase_deg\n" + rows(F, np.abs(H), WRAPPED),
    "angular.csv": "omega [rad/s];Betrag [dB];Phase [deg]\n"
    + rows(2.0 * np.pi * F, DB, WRAPPED, separator=";", decimal=","),
    "parts.txt": "Frequency\treal\timag\n" + rows(F, H.real, H.imag, separator="\t"),
    "bode100.csv": BODE_100 + rows(F, DB, WRAPPED, 0 * F),
    "bode100_forms.csv": "Frequency (Hz),TR1: Gain (Real),TR1: Gain (Imag),TR1: Gain (dB),TR2: Gain (Real),"
    "TR2: Gain (Imag),TR2: Gain (Degree)\n" + rows(F, H.real, H.imag, DB, H.real, H.imag, WRAPPED),
    "bode100_two_traces.csv": "Frequency (Hz),TR1: Gain (dB),TR2: Gain (Degree)\n" + rows(F, DB, WRAPPED),
    "second_channel_is_whole.csv": "Frequency (Hz),C1 Gain (dB),C2 Gain (dB),C2 Phase (deg)\n"
    + rows(F, 0 * F, DB, WRAPPED),
    "names_as_ours.csv": "frequency_hz,magnitude_db,phase_deg\n" + rows(F, DB, WRAPPED),
    "a_remark_first.csv": "# bench 3\nfreq_hz,re,im\n" + rows(F, H.real, H.imag),
    "simplis.txt": "Frequency\tdb(VOUT)\tphase(VOUT)\n" + rows(F, DB, WRAPPED, separator="\t"),
    "ltspice_polar.txt": "Freq.\tV(out)/V(in)\n"
    + "".join(f"{f:.15e}\t({a:.15e}dB,{b:.15e}°)\n" for f, a, b in zip(F, DB, WRAPPED, strict=True)),
    "ltspice_parts.txt": "Freq.\tV(out)\n"
    + "".join(f"{f:.15e}\t{h.real:.15e},{h.imag:.15e}\n" for f, h in zip(F, H, strict=True)),
    "falling.csv": "Frequency (Hz),Magnitude (dB),Phase (deg)\n" + rows(F[::-1], DB[::-1], WRAPPED[::-1]),
}


@pytest.mark.parametrize("encoding", ["utf-8", "cp1252"])
@pytest.mark.parametrize("name", TABLES)
def test_a_table_reads_as_the_response_that_it_was_written_from(name, encoding, tmp_path):
    (tmp_path / name).write_bytes(TABLES[name].encode(encoding))
    found = ls.formats.read_frf(tmp_path / name, relative_std=0.02)
    np.testing.assert_allclose(found.frequency_hz, F, rtol=1e-13)
    np.testing.assert_allclose(found.siso, H, rtol=1e-12)


def test_what_nobody_says_of_dB_and_degrees_is_refused(tmp_path):
    (tmp_path / "a.csv").write_text("f,gain,phase\n1,2,300\n2,3,400\n")
    with pytest.raises(ls.LoopshapeError, match=r"dB or a ratio.*\(dB\) or \(abs\)"):
        ls.formats.read_frf(tmp_path / "a.csv", relative_std=0.01)
    (tmp_path / "a.csv").write_text("f,gain (dB),phase\n1,2,3\n2,3,4\n")
    with pytest.raises(ls.LoopshapeError, match=r"deg or rad.*\(deg\) or \(rad\)"):
        ls.formats.read_frf(tmp_path / "a.csv", relative_std=0.01)


# written by scikit-rf 2.2.0: Network(s=..., z0=50).write_touchstone, and with form="db"
TOUCHSTONE = """! Created with skrf 2.2.0 (http://scikit-rf.org).
# Hz S RI R 50.0
!freq ReS11 ImS11 ReS21 ImS21 ReS12 ImS12 ReS22 ImS22
10.0 0.1 0.2 0.3 -0.4 0.5 0.6 0.7 0.8
20.0 0.11 0.21 0.31 -0.41 0.51 0.61 0.71 0.81
"""


def test_a_touchstone_file_holds_21_before_12(tmp_path):
    (tmp_path / "n.s2p").write_text(TOUCHSTONE)
    found = ls.formats.read_frf(tmp_path / "n.s2p", relative_std=0.01)
    np.testing.assert_array_equal(found.frequency_hz, [10.0, 20.0])
    np.testing.assert_array_equal(found.response[0], [[0.1 + 0.2j, 0.5 + 0.6j], [0.3 - 0.4j, 0.7 + 0.8j]])


def test_a_touchstone_file_in_dB_and_MHz_and_with_noise(tmp_path):
    text = "# mhz s db r 50\n! a remark\n1 -6.0 90 ! behind\n2 -20 -180\n"
    (tmp_path / "n.s1p").write_text(text)
    found = ls.formats.read_frf(tmp_path / "n.s1p", relative_std=0.01)
    np.testing.assert_array_equal(found.frequency_hz, [1e6, 2e6])
    np.testing.assert_allclose(found.siso, [10 ** (-0.3) * 1j, -0.1], rtol=1e-12)
    (tmp_path / "n.s1p").write_text("1 2 3\n")
    with pytest.raises(ls.LoopshapeError, match="# HZ S RI R 50"):
        ls.formats.read_frf(tmp_path / "n.s1p", relative_std=0.01)


ROWS = "10 1 0\n20 .9 0\n{}30 .8 0\n40 .7 0\n"


@pytest.mark.parametrize("between", ["20 .9 0\n", "15 .9 0\n", "5 1 0\n6 1 0\n"])
def test_a_touchstone_file_whose_frequencies_do_not_rise_is_refused(between, tmp_path):
    (tmp_path / "n.s1p").write_text("# HZ S RI R 50\n" + ROWS.format(between))
    with pytest.raises(ls.LoopshapeError, match="do not rise at row 3"):
        ls.formats.read_frf(tmp_path / "n.s1p", relative_std=0.01)
    (tmp_path / "n.s1p").write_text("# HZ S RI R 50\n" + ROWS.format(""))
    assert ls.formats.read_frf(tmp_path / "n.s1p", relative_std=0.01).frequency_hz.size == 4


def test_noise_parameters_are_those_of_two_ports_and_are_counted(tmp_path):
    network = "".join(f"{f} 1 0 2 0 3 0 4 0\n" for f in (10, 20, 30))
    (tmp_path / "n.s2p").write_text("# HZ S RI R 50\n" + network + "10 1 .5 30 .2\n20 1 .5 30 .2\n")
    found = ls.formats.read_frf(tmp_path / "n.s2p", relative_std=0.01)
    assert found.frequency_hz.tolist() == [10.0, 20.0, 30.0]
    assert "2 rows of noise parameters were left out" in found.notes
    (tmp_path / "n.s2p").write_text("# HZ S RI R 50\n" + network + network)
    with pytest.raises(ls.LoopshapeError, match="do not rise at row 4"):
        ls.formats.read_frf(tmp_path / "n.s2p", relative_std=0.01)
    (tmp_path / "n.s2p").write_text("# HZ S RI R 50\n[Two-Port Data Order] 12_21\n" + network)
    with pytest.raises(ls.LoopshapeError, match="save it as version 1"):
        ls.formats.read_frf(tmp_path / "n.s2p", relative_std=0.01)


def test_parts_of_several_traces_are_not_put_together(tmp_path):
    text = "Frequency (Hz),TR1: Gain (dB),TR2: Gain (Degree),TR3: Gain (Degree)\n"
    (tmp_path / "a.csv").write_text(text + rows(F, DB, WRAPPED, WRAPPED))
    with pytest.raises(ls.LoopshapeError, match="no table of an FRF"):
        ls.formats.read_frf(tmp_path / "a.csv", relative_std=0.01)


def test_a_loop_measured_whole_gives_its_plant_with_the_loop_s_error(tmp_path):
    C = ls.controller(ls.gain(0.02), ls.pi(5.0), ls.lead_lag(20.0, 400.0), rate_hz=1e5, computation_delay_s=1e-5)
    L = H * C.response(F)
    (tmp_path / "L.csv").write_text(
        "Frequency (Hz),Magnitude (dB),Phase (deg),coherence\n"
        + rows(F, 20.0 * np.log10(np.abs(L)), np.degrees(np.angle(-L)), np.full(F.size, 0.99))
    )
    P = ls.formats.read_frf(tmp_path / "L.csv", averages=50, complete_loop=C, negative=True)
    np.testing.assert_allclose(P.siso, H, rtol=1e-12)
    np.testing.assert_allclose(P.variance[:, 0, 0], np.abs(H) ** 2 * 0.01 / (0.99 * 49), rtol=1e-12)  # by |C|²
    assert P.rate_hz == 1e5
    assert any("complete loop" in note for note in P.notes)


def test_arrays_in_dB_degrees_and_rad_s_are_the_same_response():
    one = ls.FRF.from_arrays(F, H, relative_std=0.01)
    two = ls.FRF.from_arrays(
        omega_rad_s=2.0 * np.pi * F, magnitude_db=DB, phase_deg=UNWRAPPED, relative_std=0.01
    )  # fmt: skip
    np.testing.assert_allclose(two.frequency_hz, one.frequency_hz, rtol=1e-15)
    np.testing.assert_allclose(two.siso, one.siso, rtol=1e-12)
