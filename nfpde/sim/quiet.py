"""MuJoCo's log, silenced while simulations may diverge."""

from collections.abc import Iterator
from contextlib import contextmanager

import mujoco


@contextmanager
def quiet_mujoco() -> Iterator[None]:
    """No lines on the console and in MUJOCO_LOG.TXT: a simulation that diverges is reported as NaN instead.

    The setting belongs to the whole process; it is put back at the end.
    """
    log = mujoco.MjLogConfig.get()
    before = log.logto_console, log.logto_file
    log.logto_console = log.logto_file = False
    mujoco.MjLogConfig.set(log)
    try:
        yield
    finally:
        log.logto_console, log.logto_file = before
        mujoco.MjLogConfig.set(log)
