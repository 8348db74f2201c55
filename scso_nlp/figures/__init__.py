"""Figures of solutions and comparisons: one style, one panel grid; every function returns a new Figure."""

from scso_nlp.figures.comparison import activity_pages as activity_pages
from scso_nlp.figures.comparison import plot_activity as plot_activity
from scso_nlp.figures.comparison import plot_mean_activity as plot_mean_activity
from scso_nlp.figures.comparison import plot_sweep as plot_sweep
from scso_nlp.figures.comparison import plot_task_bars as plot_task_bars
from scso_nlp.figures.contributions import plot_contributions as plot_contributions
from scso_nlp.figures.frames import HorizontalAxis as HorizontalAxis
from scso_nlp.figures.frames import percent_of_motion as percent_of_motion
from scso_nlp.figures.joint_reactions import plot_joint_reactions as plot_joint_reactions
from scso_nlp.figures.muscle_lines import plot_muscle_lines as plot_muscle_lines
from scso_nlp.figures.quantity import QUANTITIES as QUANTITIES
from scso_nlp.figures.quantity import plot_quantity as plot_quantity
from scso_nlp.figures.saving import draw_and_save as draw_and_save
from scso_nlp.figures.saving import save_figure as save_figure
from scso_nlp.figures.series import Series as Series
from scso_nlp.figures.solution import activation_pages as activation_pages
from scso_nlp.figures.solution import plot_activations as plot_activations
from scso_nlp.figures.solution import plot_forces as plot_forces
from scso_nlp.figures.solution import plot_moments as plot_moments
from scso_nlp.figures.solution import plot_stability as plot_stability
from scso_nlp.figures.solution import series_of as series_of
from scso_nlp.figures.tendon_forces import TendonForceDifference as TendonForceDifference
from scso_nlp.figures.tendon_forces import plot_tendon_forces as plot_tendon_forces
from scso_nlp.figures.tendon_forces import tendon_force_difference as tendon_force_difference
from scso_nlp.figures.uncertainty import plot_uncertainty as plot_uncertainty
