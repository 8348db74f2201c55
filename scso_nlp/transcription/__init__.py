"""From a problem description to a nonlinear program and back.

The only folder that knows how symbols of one frame become one program over all frames.
"""

from scso_nlp.transcription.build import Program as Program
from scso_nlp.transcription.build import build_program as build_program
