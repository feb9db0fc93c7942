"""A parameter space at work inside a running Gymnasium environment: model fields, and effects at every physics step."""

from __future__ import annotations

from typing import Any

import gymnasium
import mujoco
import numpy as np
from numpy.typing import NDArray

from nfpde.effects import World
from nfpde.effects.effect import overrides
from nfpde.errors import BadEffect, BadInput, NfpdeError
from nfpde.parameters import ParameterSpace
from nfpde.sim import MujocoSimulator
from nfpde.sim.acting import BeforeStep, BoundEffects, RowEffects
from nfpde.sim.fields import get_field, set_field
from nfpde.sim.quiet import quiet_mujoco

Array = NDArray[np.float64]


_OF_A_LAG = 4
"""Commands that tell enough of what a lag has in store."""


class PhysicsDiverged(Exception):
    """Ends the environment's step or reset from inside; whoever steps it catches it."""


class LivePhysics:
    """Replaces the physics of one environment by that of `MujocoSimulator` with the same parameters.

    The environment's own model and data stay in use. Its solver settings become those of `nfpde.sim.load_model`, so
    that a policy trains in the simulation whose parameters were estimated. Effects act where they do in
    `MujocoSimulator`: model fields once per vector, commands and forces at every physics step, sensors on what
    `_get_obs` sees (rewards and terminations see the true state).

    Args:
        env: the bare environment, `env.unwrapped`.
        space: the parameters, those of effects last.
        observes: whether what sensors report is to be seen in the environment's observations.

    A step that goes past `do_simulation`, or past `_get_obs` where sensors are off, is refused once it is made.

    Raises:
        BadInput: no MuJoCo environment, or one that is wrapped already.
        BadParameter, BadEffect: the model lacks an element of the space, or an effect cannot act in this environment.
    """

    def __init__(self, env: gymnasium.Env[Any, Any], space: ParameterSpace, *, observes: bool = True) -> None:
        self.env: Any = env
        self.space = space
        self._observes = observes
        self.label = _label(env)
        _check_environment(self.env, self.label)
        try:
            self._simulator = MujocoSimulator(self.env.model, space, nthread=1, check_influence=False)
        except NfpdeError as error:
            raise type(error)(f"environment {self.label}: {error}") from None
        nominal, options = self._simulator.model, self.env.model.opt
        self._own_options = (options.solver, options.disableflags)
        # the nominal model, whose timestep is the one in which effects count, whatever `time_scale` makes of it
        self._bound = BoundEffects(nominal, self._simulator.effects, self._simulator.writer.nbase)
        dead = [e for e in self._bound.effects if not e.live]
        if dead:
            raise BadEffect(
                f"environment {self.label}: {dead[0].name} on {dead[0].target!r} remembers commands of any age, and an "
                "environment keeps the last few; use another reading of the effect there"
            )
        self._on_sensor = [e for e in self._bound.effects if overrides(e, "to_measured")]
        self._memory_steps = self._simulator.history_steps(nominal.opt.timestep)
        self._effects = self._effects_at(None)
        self._before_step: BeforeStep | None = None
        self._past: Array | None = None
        self._simulated = self._observed = 0  # calls of what is replaced, of which every step has to make some
        self._observed_before = 0
        self._install()  # before which nothing of the environment has changed, should it be refused
        options.solver, options.disableflags = nominal.opt.solver, nominal.opt.disableflags

    @property
    def nominal_model(self) -> mujoco.MjModel:
        """The environment's model before any parameter was written, as `load_model` prepares it."""
        return self._simulator.model

    @property
    def control_dt(self) -> float:
        """Control step [s] of the environment, in the nominal model's time."""
        return float(self.nominal_model.opt.timestep) * int(self.env.frame_skip)

    @property
    def pending_commands(self) -> int:
        """Commands that may be under way, or still act, when the next one is given.

        Of delays as many as they hold back at most; of other effects that remember commands, as lags, four at most:
        older ones count for little, and what they did shows in the motion.
        """
        behind = np.zeros(max(1, self.nominal_model.nu), dtype=np.int64)
        for e in self._bound.effects:
            held = int(np.ceil(e.memory_time() / self.control_dt - 1e-9))
            is_delay = any(q.name == "delay" for q in e.quantities)
            behind[e.ctrls if e.kind == "actuator" else slice(None)] += held if is_delay else min(held, _OF_A_LAG)
        return int(behind.max())

    def write(self, xi: Array | None) -> None:
        """Give the model the parameters xi (D,), or its nominal ones (None); to be called before the inner reset."""
        model, writer = self.env.model, self._simulator.writer
        for name in {*self._bound.step_fields, *writer.fields}:
            set_field(model, name, get_field(writer.nominal, name))
        if xi is None:
            mujoco.mj_setConst(model, mujoco.MjData(model))
        else:
            writer.write(model, xi)
        self._effects = self._effects_at(xi)
        self._past = self._before_step = None
        self._observed_before = self._observed

    def start(self) -> None:
        """Forget what effects and solver remember of the last episode; to be called after the inner reset.

        Raises:
            BadEffect: sensors are off, and the reset did not ask `_get_obs` what they say.
        """
        self._check_observed("reset", self._observed_before)
        model, data = self.env.model, self.env.data
        data.qacc_warmstart[:] = 0.0
        if self._before_step is not None:  # the environment let the robot settle: effects may have changed fields
            for name, field in self._before_step.fields.items():
                set_field(model, name, field[0])
        self._past = self._before_step = None

    def measured(self) -> Array:
        """What sensors report of the state as it is now, (nq+nv,)."""
        data = self.env.data
        return self._effects.to_measured(np.concatenate([data.qpos, data.qvel])[None, None])[0, 0]

    def release(self) -> None:
        """Give the environment its own methods back, and its model the nominal parameters and its own solver."""
        self.write(None)
        self._uninstall()

    def _uninstall(self) -> None:
        self.env.model.opt.solver, self.env.model.opt.disableflags = self._own_options
        for name in ("do_simulation", "_get_obs", "step"):
            vars(self.env).pop(name, None)

    def _effects_at(self, xi: Array | None) -> RowEffects:
        """The effects with the parameters of one vector (D,), or neutral ones."""
        return self._bound.on_rows((self._simulator.nominal() if xi is None else xi)[None])

    def _install(self) -> None:
        if self._bound.on_command or self._bound.on_step:
            self._check_stepping()
        if self._on_sensor and self._observes:
            self._check_observation()
            self._own_observation = self.env._get_obs
            self.env._get_obs = self._observe
        self._own_simulation, self._own_step = self.env.do_simulation, self.env.step
        self.env.do_simulation, self.env.step = self._simulate, self._step

    def _step(self, action: Any) -> Any:
        """The environment's own step, seen to go through what is replaced here."""
        simulated, observed = self._simulated, self._observed
        result = self._own_step(action)
        if self._simulated == simulated:
            raise (BadEffect if self._bound.effects else BadInput)(
                f"environment {self.label}: its step() made no call of do_simulation, where effects act and a "
                "simulation that diverges is seen; let every step call self.do_simulation(ctrl, self.frame_skip)"
            )
        self._check_observed("step", observed)
        return result

    def _check_observed(self, method: str, before: int) -> None:
        if self._on_sensor and self._observes and self._observed == before:
            names = ", ".join(sorted({e.name for e in self._on_sensor}))
            raise BadEffect(
                f"environment {self.label}: its {method}() made no call of _get_obs, where effects on sensors act "
                f"({names}); let it return the observation that self._get_obs() gives"
            )

    def _simulate(self, ctrl: Any, n_frames: int) -> None:
        self._simulated += 1
        data = self.env.data
        data.warning.number[:] = 0  # MuJoCo counts from 0 again where it starts a simulation afresh
        with quiet_mujoco():
            if self._effects.between_steps:
                self._substeps(np.asarray(ctrl, dtype=np.float64), n_frames)
            else:
                self._own_simulation(ctrl, n_frames)
        # as in MujocoSimulator, every warning that MuJoCo counts makes its numbers wrong
        if data.warning.number.any() or not np.isfinite(data.qvel).all():
            raise PhysicsDiverged

    def _substeps(self, ctrl: Array, n_frames: int) -> None:
        env, model = self.env, self.env.model
        if ctrl.shape != (model.nu,):
            raise BadInput(f"environment {self.label}: an action has shape ({model.nu},), got {ctrl.shape}")
        before_step = self._before_step or self._bind_effects()
        own = env.data.qfrc_applied.copy(), env.data.xfrc_applied.copy()  # the environment's, as of a gust or a helper
        before_step.own_forces = own
        try:
            for command in self._commands(ctrl, n_frames):
                env.data.ctrl[:] = command
                before_step()
                for name, field in before_step.world.fields.items():
                    set_field(model, name, field[0])
                mujoco.mj_step(model, env.data)
            env.data.ctrl[:] = ctrl  # what the policy asked for is what a control cost charges
            mujoco.mj_rnePostConstraint(model, env.data)
        finally:
            env.data.qfrc_applied[:], env.data.xfrc_applied[:] = own

    def _bind_effects(self) -> BeforeStep:
        """What effects do before every physics step, bound to the state as it is now."""
        model, data = self.env.model, self.env.data
        state = (getattr(data, name)[None] for name in ("qpos", "qvel", "ctrl", "qfrc_applied", "xfrc_applied"))
        fields = {f: np.array(get_field(model, f))[None] for f in self._bound.step_fields}
        self._before_step = self._effects.before_step(World(self.nominal_model, *state, fields=fields))
        return self._before_step

    def _commands(self, ctrl: Array, n_frames: int) -> Array:
        """Commands of the next physics steps after the effects on them, (n_frames, nu)."""
        new = np.tile(ctrl, (n_frames, 1))
        if self._past is None:  # before the first command nothing is known: it holds, as in recordings
            self._past = np.tile(ctrl, (self._memory_steps, 1))
        signal = np.concatenate([self._past, new])[None]
        self._past = signal[0, len(new) :].copy()
        return self._effects.delivered(signal)[0, -n_frames:]

    def _observe(self) -> Any:
        """The environment's observation, computed from the measured state."""
        self._observed += 1
        data, nq = self.env.data, self.env.model.nq
        true, measured = np.concatenate([data.qpos, data.qvel]), self.measured()
        try:
            data.qpos[:], data.qvel[:] = measured[:nq], measured[nq:]
            return self._own_observation()
        finally:
            data.qpos[:], data.qvel[:] = true[:nq], true[nq:]

    def _check_stepping(self) -> None:
        base = _mujoco_env()
        for name in ("do_simulation", "_step_mujoco_simulation"):
            if getattr(type(self.env), name) is not getattr(base, name):
                self._refuse(f"its class has its own {name}, so effects on commands and forces cannot act in it")

    def _check_observation(self) -> None:
        """Sensor effects need observations that are a function of qpos and qvel alone; find out by trying."""
        if not callable(getattr(self.env, "_get_obs", None)):
            self._refuse("it has no method _get_obs, so effects on sensors cannot act in it")
        stream = self.env.np_random.bit_generator
        before = stream.state
        try:
            self.env.reset()  # an observation may hold what only a reset makes, a goal for example
        finally:
            stream.state = before
        data, model = self.env.data, self.env.model
        saved = np.concatenate([data.qpos, data.qvel])
        try:
            first = numbers_of(self.env._get_obs())
            rng = np.random.default_rng(0)
            other = model.qpos0.copy()
            mujoco.mj_integratePos(model, other, rng.normal(size=model.nv), 1.0)
            data.qpos[:], data.qvel[:] = other, rng.normal(size=model.nv)
            data.ctrl[:] = rng.normal(size=model.nu)
            mujoco.mj_forward(model, data)
            mujoco.mj_rnePostConstraint(model, data)
            data.qpos[:], data.qvel[:] = saved[: model.nq], saved[model.nq :]
            second = numbers_of(self.env._get_obs())
        finally:
            data.qpos[:], data.qvel[:] = saved[: model.nq], saved[model.nq :]
            data.ctrl[:] = 0.0
            mujoco.mj_forward(model, data)
        if not np.array_equal(first, second):
            self._refuse(
                "its observation holds more than qpos and qvel (forces, inertias, positions of sites ...), which no "
                "sensor effect describes; switch those parts of the observation off"
            )

    def _refuse(self, reason: str) -> None:
        names = ", ".join(sorted({e.name for e in self._bound.effects}))
        self._uninstall()
        raise BadEffect(f"environment {self.label}: {reason}. Effects of the space: {names}")


def numbers_of(observation: Any) -> Array:
    """All numbers of an observation in a row, those of its parts one behind the other."""
    if isinstance(observation, dict):
        observation = tuple(observation[key] for key in sorted(observation))
    if isinstance(observation, tuple):
        return np.concatenate([numbers_of(part) for part in observation] or [np.empty(0)])
    array = np.asarray(observation)
    return array.astype(np.float64).ravel() if array.dtype.kind in "biuf" else np.empty(0)


def _mujoco_env() -> type:
    from gymnasium.envs.mujoco import MujocoEnv  # loads the renderers

    return MujocoEnv


def _label(env: Any) -> str:
    return env.spec.id if getattr(env, "spec", None) is not None else type(env).__name__


def _check_environment(env: Any, label: str) -> None:
    if not isinstance(env, _mujoco_env()):
        raise BadInput(
            f"environment {label} is a {type(env).__name__}, no gymnasium.envs.mujoco.MujocoEnv: it has no MuJoCo "
            "model into which parameters could be written"
        )
    if "do_simulation" in vars(env):
        raise BadInput(
            f"environment {label} is under RandomizedParameters already; make another one, or release() the first"
        )
