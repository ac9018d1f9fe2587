"""The perturbation of any robot's plant: what all installed base types' models have, for experiments whose robot is a setting."""

from __future__ import annotations

from typing import TYPE_CHECKING

from wbmpc.bases import available_base_types
from wbmpc.errors import InputError
from wbmpc.simulation.perturbation import Perturbation, WheeledPerturbation, perturbation_model


def models() -> tuple[type[Perturbation], ...]:
    """The models of the installed base types, without those that others of them extend; of packages that cannot be imported there is none."""
    found: dict[type[Perturbation], None] = {}
    for name in available_base_types():
        try:
            found[perturbation_model(name)] = None
        except InputError:
            continue
    return tuple(m for m in found if not any(m is not other and issubclass(other, m) for other in found))


if TYPE_CHECKING:

    class AnyPerturbation(WheeledPerturbation):
        """Type checkers see the settings of robots on wheels alone."""
else:

    class AnyPerturbation(*models()):
        """Settings of all base types. What a robot's own plant does not have, it rejects (:meth:`Perturbation.of`)."""
