"""How sure: exact derivatives of optima by what their problems were given, and bands made of them."""

from scso_nlp.sensitivities.bands import Bands as Bands
from scso_nlp.sensitivities.bands import bands as bands
from scso_nlp.sensitivities.parameters import Parameter as Parameter
from scso_nlp.sensitivities.sensitivity import Gradient as Gradient
from scso_nlp.sensitivities.sensitivity import Regularity as Regularity
from scso_nlp.sensitivities.sensitivity import Sensitivity as Sensitivity
from scso_nlp.sensitivities.sensitivity import adjoint_sensitivity as adjoint_sensitivity
from scso_nlp.sensitivities.sensitivity import sensitivity as sensitivity
