"""Constants that models, estimators and simulated robots share."""

from __future__ import annotations

#: Acceleration of gravity [m/s²]: MuJoCo's default (``option.gravity``), with which robots are simulated; so models and sensors agree.
GRAVITY = 9.81
#: Slides are sections of one telescope if the cosine of their axes is more.
TELESCOPE = 0.999
