"""What an effect to hide in recordings looks like on a command line."""

from __future__ import annotations

import shlex

import mujoco

from nfpde.benchmarks import Hidden, hide
from nfpde.errors import BadEffect


def read_hidden(model: mujoco.MjModel, text: str) -> Hidden:
    """What a command line says: `coulomb_friction hinge torque=0.2`, name, target where it has one, and values.

    Raises:
        BadEffect: another form, or what `hide` refuses.
    """
    try:
        words = shlex.split(text)
    except ValueError as error:
        raise BadEffect(f"effect {text!r}: {error}") from None
    named = [w for w in words if "=" not in w]
    given = [w.partition("=") for w in words if "=" in w]
    if not 1 <= len(named) <= 2 or words[: len(named)] != named:
        raise BadEffect(
            f"effect {text!r}: give its name, the element it acts on where it acts on one, and its values, as in "
            "'coulomb_friction hinge torque=0.2' or 'actuation_delay delay=0.02'"
        )
    values = {}
    for key, _, number in given:
        if key in values:
            raise BadEffect(f"effect {text!r}: {key} is given twice")
        try:
            values[key] = float(number)
        except ValueError:
            raise BadEffect(f"effect {text!r}: {key} must be a number, got {number!r}") from None
    return hide(model, named[0], named[1] if len(named) == 2 else None, **values)
