"""Files of a run that no public verb reads or writes alone, for tests: the one place that knows where they live."""

import loopshape as ls
from loopshape.io.csv_text import CsvShape
from loopshape.io.files import read_json, read_toml, write_json, write_text_whole, write_toml
from loopshape.io.requirements import read_required
from loopshape.io.run.journal import read_journal
from loopshape.io.run.run_folder import add_recording, check_recordings, finished, start_run, write_run
from loopshape.io.run.verify import verify
from loopshape.io.write.controllers import write_controllers
from loopshape.io.write.fits import read, read_fits, write_fits
from loopshape.io.write.frfs import read_frfs, read_matrices, write_frfs, write_matrices
from loopshape.io.write.verdicts import read_verdicts, write_verdicts


def requirements_of(table):
    """What a requirements file asks of a loop, from the loop's table."""
    return read(ls.Requirements, table, "requirements")


__all__ = [
    "CsvShape",
    "add_recording",
    "check_recordings",
    "finished",
    "read_fits",
    "read_frfs",
    "read_journal",
    "read_json",
    "read_matrices",
    "read_required",
    "read_toml",
    "read_verdicts",
    "requirements_of",
    "start_run",
    "verify",
    "write_controllers",
    "write_fits",
    "write_frfs",
    "write_json",
    "write_matrices",
    "write_run",
    "write_text_whole",
    "write_toml",
    "write_verdicts",
]
