"""MuJoCo's log, silenced while models are compiled and while simulations may diverge."""

from collections.abc import Iterator
from contextlib import contextmanager

import mujoco


@contextmanager
def quiet_mujoco() -> Iterator[None]:
    """No lines on the console and in MUJOCO_LOG.TXT, which MuJoCo writes into the current folder.

    A simulation that diverges is reported as NaN instead, a model that cannot be compiled as an exception.

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
