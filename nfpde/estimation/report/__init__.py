"""The report of a fit by trajectory: one HTML file that opens offline, and its main picture as PNG."""

from nfpde.estimation.report.page import write_report as write_report
