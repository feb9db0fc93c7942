"""Every error nfpde raises on purpose; all of them are `NfpdeError`.

A message says what is wrong, where (file, episode, row, field, element), the rule it breaks and what to do.
"""


class NfpdeError(Exception):
    """Root of nfpde's errors; catch it to catch them all."""


class BadDataset(NfpdeError):
    """Recordings that break a rule of the data format, or do not fit the model."""


class BadParameter(NfpdeError):
    """A parameter or parameter space that cannot be used: unknown field or target, bounds, no influence."""


class BadModel(NfpdeError):
    """A model that cannot be loaded, or uses something that this simulator does not support."""


class BadEffect(NfpdeError):
    """An effect that does not exist, or that cannot act on the target it was given."""


class BadInput(NfpdeError):
    """Any other argument, file or array that breaks a rule."""


class SpaceMismatch(NfpdeError):
    """Two parameter spaces that should be the same and are not."""


class NotOptimal(NfpdeError):
    """A transport plan whose optimality could not be certified."""


class SimulationDiverged(NfpdeError):
    """A simulation that blew up where no finite answer may be given."""


class CheckpointMismatch(NfpdeError):
    """A run's folder whose saved state belongs to another run."""
