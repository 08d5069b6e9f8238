"""Small files that ask for a machine's whole memory or time end in a sentence, by the commands that read them.

Each is written into the bench's folder in place of a sound file; the command has a gigabyte more than it began with,
and a time limit. Five more, read as recordings, stand in `test_readers_under_fuzz.py`.
"""

import os
import resource
import shutil
import signal
import struct
import zipfile
from pathlib import Path

import bench
import pytest
import wide_bench

MORE_BYTES = 1_000_000_000
LIMIT_S = 60


def deep_toml(path):
    """Arrays in arrays, a hundred thousand deep."""
    path.write_text('format = "loopshape-run/1"\nnotes = ' + "[" * 100_000 + "]" * 100_000 + "\n")


def deep_json(path):
    path.write_text("[" * 200_000 + "]" * 200_000)


def endless_number(path):
    """An integer of a million digits where a rate stands."""
    path.write_text(f'format = "loopshape-controllers/1"\nrate_hz = {"9" * 1_000_000}\n')


def endless_line(path):
    """A table of FRFs that is one line of 50 MB."""
    path.write_text("frequency_hz,real,imag\n" + "1," * 25_000_000)


def zip_of_zeros(path):
    """An FRF file whose response unpacks to 8 GB of zeros."""
    head = b"{'descr': '<c16', 'fortran_order': False, 'shape': (536870912,), }".ljust(117) + b"\n"
    with (
        zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as file,
        file.open("response.npy", "w", force_zip64=True) as member,
    ):
        member.write(b"\x93NUMPY\x01\x00" + len(head).to_bytes(2, "little") + head)
        block = bytes(2**24)
        for _ in range(24):
            member.write(block)


def zip_that_lies(path):
    """An FRF file whose array says that it has 10^15 numbers, and holds none."""
    head = b"{'descr': '<c16', 'fortran_order': False, 'shape': (1000000000000000,), }".ljust(117) + b"\n"
    with zipfile.ZipFile(path, "w") as file:
        file.writestr("response.npy", b"\x93NUMPY\x01\x00" + len(head).to_bytes(2, "little") + head)


def mat_that_lies(path):
    """A MAT file whose matrix says that it has 4 billion bytes."""
    path.write_bytes(b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM" + struct.pack("<II", 14, 2**32 - 64))


def hdf5_of_nothing(path):
    """A MAT v7.3 file with a dataset of 2^40 numbers that were never written."""
    import h5py

    with h5py.File(path, "w", userblock_size=512) as file:
        file.create_dataset("r", shape=(2**40,), dtype="f8", chunks=(2**16,))


def hole(path):
    """A recording of a terabyte of nothing."""
    path.write_text("r,z,y\n")
    os.truncate(path, 2**40)


def link_to_itself(path):
    path.unlink(missing_ok=True)
    path.symlink_to(path.name)


def parquet_of_a_footer(path):
    """A table whose footer says that it is 2 GB long."""
    path.write_bytes(b"PAR1" + bytes(64) + struct.pack("<I", 2**31 - 1) + b"PAR1")


def endless_study(path):
    path.write_text(wide_bench.STUDY.format(seed=1).replace("periods = 2", "periods = 1000000000"))


def endless_campaign(path):
    path.write_text(wide_bench.CAMPAIGN.format(draws=10**15))


BOMBS = {
    "deep run.toml": (deep_toml, "run/run.toml", "frf"),
    "deep fits.json": (deep_json, "run/fits.json", "check"),
    "deep verdict": (deep_json, "verdict.json", "check --baseline"),
    "endless number": (endless_number, "controller.toml", "check"),
    "endless line": (endless_line, "given/a.axis.csv", "import-frf"),
    "FRF of zeros": (zip_of_zeros, "run/frf/a.axis.npz", "check"),
    "FRF that lies": (zip_that_lies, "run/frf/a.axis.npz", "check"),
    "MAT that lies": (mat_that_lies, "given/a.axis.mat", "import-frf --replace"),
    "HDF5 of nothing": (hdf5_of_nothing, "given/a.axis.mat", "import-frf --replace"),
    "recording of a hole": (hole, "a.csv", "import another"),
    "link to itself": (link_to_itself, "controller.toml", "check"),
    "Parquet of a footer": (parquet_of_a_footer, "run/a.parquet", "frf"),
    "endless study": (endless_study, "study.toml", "measure"),
    "endless campaign": (endless_campaign, "campaign.toml", "campaign"),
}


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return wide_bench.prepare(tmp_path_factory.mktemp("bombs") / "whole")


def limited():
    """A gigabyte more than this process has, and an alarm that nothing catches."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    most = pages * resource.getpagesize() + MORE_BYTES
    resource.setrlimit(resource.RLIMIT_AS, (most, most))
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.alarm(LIMIT_S)


@pytest.mark.long
@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="needs /proc")
@pytest.mark.parametrize("name", BOMBS)
def test_it_ends_in_a_sentence(whole, tmp_path, name):
    make, file, words = BOMBS[name]
    folder = tmp_path / "work"
    shutil.copytree(whole, folder)
    path = folder / file
    assert path.exists(), sorted(p.name for p in path.parent.iterdir())
    make(path)
    done = bench.command(wide_bench.commands(folder)[words], before=limited)
    assert done.code == 2, (done.code, done.out[-300:], done.err[-1500:])
    assert done.err.startswith("loopshape: "), done.err[-1500:]
    assert "Traceback" not in done.err
    assert len(done.err) < 2000
