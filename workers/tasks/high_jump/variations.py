"""Other athletes (Yin et al. 2021): a weak take-off leg, a spine that does not bend back, a knee in a cast."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import replace
from typing import Literal

from workers.physics.athlete import JOINTS, Joint

Spine = Literal["free", "stiff"]
Cast = Literal["none", "take_off", "swing"]

TAKE_OFF_LEG = ("right_hip", "right_knee", "right_ankle")
_KNEES: Mapping[Cast, str] = {"take_off": "right_knee", "swing": "left_knee"}
_STRAIGHT = (-0.1, 0.0)
"""rad that a knee in a cast still moves by."""
_PLASTER = 4.0
"""A cast is so much stiffer, and bears so much more torque, than the muscles about the knee."""


@functools.cache
def varied_joints(take_off_leg: float, spine: Spine, cast: Cast) -> tuple[Joint, ...]:
    """The athlete's joints.

    Args:
        take_off_leg: torque of the take-off leg's joints over the usual one.
        spine: `stiff` keeps the chest from bending back.
        cast: whose knee is all but straight.
    """

    def varied(joint: Joint) -> Joint:
        if joint.name in TAKE_OFF_LEG and take_off_leg != 1.0:
            joint = replace(joint, torque=joint.torque * take_off_leg)
        if joint.name == "chest" and spine == "stiff":  # positive about z is back
            joint = replace(joint, high=(*joint.high[:2], 0.0))
        if joint.name == _KNEES.get(cast):
            low, high = _STRAIGHT
            stiffness, torque = joint.stiffness * _PLASTER, joint.torque * _PLASTER
            joint = replace(joint, low=(low,), high=(high,), stiffness=stiffness, torque=torque, held=True)
        return joint

    return tuple(varied(joint) for joint in JOINTS)
