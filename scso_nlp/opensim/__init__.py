"""OpenSim as an engine: setup files and motions in, frozen arrays out, each run in processes of its own."""

from scso_nlp.opensim.engine import load_motion
from scso_nlp.opensim.setup_xml import AnalyzeSetup, MotionInput, read_analyze_setup

__all__ = ["AnalyzeSetup", "MotionInput", "load_motion", "read_analyze_setup"]
