"""Recordings of real robots: episodes, data sets, windows, and the files that hold them."""

from nfpde.dataset.columns import ColumnNames as ColumnNames
from nfpde.dataset.columns import expand_names as expand_names
from nfpde.dataset.dataset import Dataset as Dataset
from nfpde.dataset.dropo import load_dropo as load_dropo
from nfpde.dataset.episode import Episode as Episode
from nfpde.dataset.files import load_dataset as load_dataset
from nfpde.dataset.files import save_dataset as save_dataset
from nfpde.dataset.metadata import Metadata as Metadata
from nfpde.dataset.model_fit import check_against_model as check_against_model
from nfpde.dataset.resample import resample_episode as resample_episode
from nfpde.dataset.resample import split_episode_at_gaps as split_episode_at_gaps
from nfpde.dataset.velocities import differentiate_episode as differentiate_episode
from nfpde.dataset.windows import Windows as Windows
