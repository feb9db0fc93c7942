"""Simulators: what a robot with given parameters does from a measured state under recorded commands."""

from nfpde.sim.callable import CallableSimulator as CallableSimulator
from nfpde.sim.cpu import MujocoSimulator as MujocoSimulator
from nfpde.sim.model import load_model as load_model
from nfpde.sim.model import model_hash as model_hash
from nfpde.sim.simulator import LOSS_LIMIT as LOSS_LIMIT
from nfpde.sim.simulator import Simulator as Simulator
from nfpde.sim.simulator import squared_error as squared_error
from nfpde.sim.states import StateSpace as StateSpace
from nfpde.sim.writer import ModelWriter as ModelWriter
