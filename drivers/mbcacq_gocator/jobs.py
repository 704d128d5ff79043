"""Which job the sensor runs: uploaded if the plan brings a file of it, then loaded; and put back as it was before."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from mbcacq.devices import ConfigError
from mbcacq_gocator.configuration import Configuration
from mbcacq_gocator.files import LIVE_CONFIGURATION, LIVE_JOB, SensorFiles, job_name

MAX_JOB = 32 * 2**20


@dataclass
class Before:
    """The sensor as it was found: the loaded job, and the live configuration with whatever nobody had saved."""

    job: str
    configuration: bytes
    changed: bool = False

    @classmethod
    def of(cls, files: SensorFiles) -> Before:
        return cls(files.loaded_job(), files.read(LIVE_CONFIGURATION))

    def restore(self, files: SensorFiles) -> None:
        """The sensor must be at rest."""
        if self.job and files.loaded_job() != self.job:
            files.copy(self.job, LIVE_JOB)
        wanted = Configuration(self.configuration).values_only()
        if Configuration(files.read(LIVE_CONFIGURATION)).values_only() != wanted:
            files.write(LIVE_CONFIGURATION, wanted)
        self.changed = False


def read_job_file(path: str) -> bytes:
    """Raises ConfigError if there is no such file, or one that cannot be a job."""
    try:
        size = Path(path).stat().st_size
        if not 0 < size <= MAX_JOB:
            raise ConfigError(f"the job file {path} has {size} bytes, a Gocator job has 1 to {MAX_JOB}")
        return Path(path).read_bytes()
    except OSError as error:
        raise ConfigError(f"the job file {path} cannot be read ({error.strerror}); correct job_file in the plan") from None


def upload(files: SensorFiles, name: str, data: bytes, replace: bool, before: Before) -> bool:
    """Store a job, unless the same bytes are there already; True if it was. Raises ConfigError where another job has that name."""
    if name in files.jobs():
        if files.read(name) == data:
            return False
        if not replace:
            raise ConfigError(
                f"the Gocator already has a job '{name}' that differs from the plan's job_file; give job another name, "
                "or set replace_job: true"
            )
    before.changed = True
    files.write(name, data)
    return True


def load(files: SensorFiles, name: str, before: Before, fresh: bool = False) -> None:
    """Make a stored job the live one, unless it is already (``fresh``: even then). Raises ConfigError naming the stored jobs."""
    wanted = job_name(name)
    if not fresh and files.loaded_job() == wanted:
        return
    stored = files.jobs()
    if wanted not in stored:
        raise ConfigError(
            f"the Gocator has no job '{wanted}' (stored: {', '.join(stored) or 'none'}); correct the job in the plan "
            "or save it on the sensor"
        )
    before.changed = True
    files.copy(wanted, LIVE_JOB)
