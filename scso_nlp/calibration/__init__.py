"""Calibration: gains and levels that measurements ask for, and how well they tell what they have not seen."""

from scso_nlp.calibration.calibrate import Calibration as Calibration
from scso_nlp.calibration.calibrate import calibrate as calibrate
from scso_nlp.calibration.measured import MeasuredEmg as MeasuredEmg
from scso_nlp.calibration.measured import MeasuredStiffness as MeasuredStiffness
from scso_nlp.calibration.measured import MeasuredTrial as MeasuredTrial
