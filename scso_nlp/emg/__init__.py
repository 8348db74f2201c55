"""Electromyography beside results: envelopes, groups of muscles, measures of agreement, and their table."""

from scso_nlp.emg.comparison import Comparison as Comparison
from scso_nlp.emg.comparison import ComparisonRow as ComparisonRow
from scso_nlp.emg.comparison import compare as compare
from scso_nlp.emg.comparison import format_comparison as format_comparison
from scso_nlp.emg.comparison import format_number as format_number
from scso_nlp.emg.comparison import write_comparison_csv as write_comparison_csv
from scso_nlp.emg.map import EmgMap as EmgMap
from scso_nlp.emg.map import GroupPair as GroupPair
from scso_nlp.emg.map import MuscleGroup as MuscleGroup
from scso_nlp.emg.map import map_skeleton as map_skeleton
from scso_nlp.emg.map import read_emg_map as read_emg_map
from scso_nlp.emg.motion_result import MotionResult as MotionResult
from scso_nlp.emg.motion_result import read_result as read_result
from scso_nlp.emg.motion_result import read_results as read_results
from scso_nlp.emg.motion_result import result_of as result_of
from scso_nlp.emg.signal import Emg as Emg
from scso_nlp.emg.signal import EnvelopeFilter as EnvelopeFilter
from scso_nlp.emg.signal import envelope as envelope
from scso_nlp.emg.signal import normalize_to_mvc as normalize_to_mvc
from scso_nlp.emg.signal import normalize_to_peak as normalize_to_peak
from scso_nlp.emg.signal import read_emg as read_emg
from scso_nlp.emg.signal import resample as resample
