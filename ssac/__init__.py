"""Synchronise and calibrate two event cameras from the motion of one object.

Events and intrinsics in, time offset and relative pose out; nothing here knows the truth.
"""

from ssac.baselines.albl import albl
from ssac.baselines.event_rate import event_rate
from ssac.baselines.zncc_e import zncc_e
from ssac.baselines.zncc_f import zncc_f
from ssac.camera import Camera, Rig
from ssac.config import Config
from ssac.errors import SsacError
from ssac.estimate import Estimate
from ssac.events import EVENT_DTYPE
from ssac.methods.algorithms import ssac, ssac_known
from ssac.methods.joint import joint, joint_from, joint_known, joint_known_from
from ssac.methods.tangency import tangency, tangency_from, tangency_known, tangency_known_from
from ssac.track.observation import Observation, prepare

__all__ = [
    "EVENT_DTYPE",
    "Camera",
    "Config",
    "Estimate",
    "Observation",
    "Rig",
    "SsacError",
    "albl",
    "event_rate",
    "joint",
    "joint_from",
    "joint_known",
    "joint_known_from",
    "prepare",
    "ssac",
    "ssac_known",
    "tangency",
    "tangency_from",
    "tangency_known",
    "tangency_known_from",
    "zncc_e",
    "zncc_f",
]
