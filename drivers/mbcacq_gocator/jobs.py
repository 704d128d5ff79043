"""Which job the sensor runs, and putting it back as it was before."""

from __future__ import annotations

from dataclasses import dataclass

from mbcacq.devices import ConfigError
from mbcacq_gocator.configuration import Configuration
from mbcacq_gocator.files import LIVE_CONFIGURATION, LIVE_JOB, SensorFiles, job_name


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


def load(files: SensorFiles, name: str, before: Before) -> None:
    """Make a stored job the live one, unless it is already. Raises ConfigError naming the stored jobs."""
    wanted = job_name(name)
    if files.loaded_job() == wanted:
        return
    stored = files.jobs()
    if wanted not in stored:
        raise ConfigError(
            f"the Gocator has no job '{wanted}' (stored: {', '.join(stored) or 'none'}); correct the job in the plan "
            "or save it on the sensor"
        )
    before.changed = True
    files.copy(wanted, LIVE_JOB)
