"""Simulators: what a robot with given parameters does from a measured state under recorded commands."""

from nfpde.sim.callable import CallableSimulator as CallableSimulator
from nfpde.sim.cpu import MujocoSimulator as MujocoSimulator
from nfpde.sim.export import export_mjcf as export_mjcf
from nfpde.sim.model import load_model as load_model
from nfpde.sim.model import model_hash as model_hash
from nfpde.sim.select import Device as Device
from nfpde.sim.select import found_device as found_device
from nfpde.sim.select import make_simulator as make_simulator
from nfpde.sim.select import runs_on as runs_on
from nfpde.sim.simulator import LOSS_LIMIT as LOSS_LIMIT
from nfpde.sim.simulator import OnDevice as OnDevice
from nfpde.sim.simulator import Simulator as Simulator
from nfpde.sim.simulator import squared_error as squared_error
from nfpde.sim.states import StateSpace as StateSpace
from nfpde.sim.whitening import Whitening as Whitening
from nfpde.sim.writer import ModelWriter as ModelWriter
