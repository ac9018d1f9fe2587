"""The perturbation of any robot's plant: what all installed base types' models have, for experiments whose robot is a setting."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING

from wbmpc.bases import TABLE, answers
from wbmpc.errors import described
from wbmpc.simulation.perturbation import Perturbation, WheeledPerturbation, perturbation_model

_LOG = logging.getLogger("wbmpc")


def models() -> tuple[type[Perturbation], ...]:
    """The models of the installed base types, without those that others of them extend; of packages that cannot be imported there is none,
    nor of a base type of another package that means something else by a setting of others: theirs would change with it."""
    found: list[type[Perturbation]] = []
    for name, model in sorted(answers(perturbation_model).items(), key=lambda each: each[0] not in TABLE):
        why = "" if name in TABLE else _unfit(model, found)
        if why:
            _LOG.warning("plant: settings of base type '%s' are left out in experiments of any robot: %s", name, why)
        elif model not in found:
            found.append(model)
    return _last(found)


def _last(kinds: list[type[Perturbation]]) -> tuple[type[Perturbation], ...]:
    """Those that no others extend."""
    return tuple(m for m in kinds if not any(m is not other and issubclass(other, m) for other in kinds))


def _unfit(model: type[Perturbation], others: list[type[Perturbation]]) -> str:
    """Why the settings of a model cannot be added to those of others; empty if they can."""
    for other in others:
        for name, info in model.model_fields.items():
            known = other.model_fields.get(name)
            if known is not None and repr(known) != repr(info):
                return f"its '{name}' is not that of other base types"
    try:
        type("Together", _last([*others, model]), {"__module__": __name__})
    except Exception as error:
        return described(error)
    return ""


if TYPE_CHECKING:

    class AnyPerturbation(WheeledPerturbation):
        """Type checkers see the settings of robots on wheels alone."""
else:

    class AnyPerturbation(*models()):
        """Settings of all base types. What a robot's own plant does not have, it rejects (:meth:`Perturbation.of`)."""
