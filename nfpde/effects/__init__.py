"""The effect library: physics that a nominal model may lack, one small file each, one registry."""

from nfpde.effects import actuation_delay as actuation_delay
from nfpde.effects import coulomb_friction as coulomb_friction
from nfpde.effects import stribeck_friction as stribeck_friction
from nfpde.effects.effect import Effect as Effect
from nfpde.effects.effect import Quantity as Quantity
from nfpde.effects.effect import World as World
from nfpde.effects.registry import all_candidates as all_candidates
from nfpde.effects.registry import effect as effect
from nfpde.effects.registry import effect_names as effect_names
from nfpde.effects.registry import effects_in as effects_in
from nfpde.effects.registry import register as register
from nfpde.effects.scales import DataScales as DataScales
