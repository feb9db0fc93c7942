"""Diagnosis of the gap between a model and recordings of a robot: where, which effect, how far it shrinks."""

from nfpde.gap.diagnose import diagnose_gap as diagnose_gap
from nfpde.gap.html_report import write_report as write_report
from nfpde.gap.journal import Journal as Journal
from nfpde.gap.report import Cause as Cause
from nfpde.gap.report import Distance as Distance
from nfpde.gap.report import Fitted as Fitted
from nfpde.gap.report import GapMap as GapMap
from nfpde.gap.report import GapReport as GapReport
from nfpde.gap.report import Level as Level
from nfpde.gap.report import Place as Place
from nfpde.gap.report import ResidualForce as ResidualForce
from nfpde.gap.report import Rival as Rival
from nfpde.gap.report import Trace as Trace
