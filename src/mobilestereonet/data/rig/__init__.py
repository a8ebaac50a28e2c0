"""The geometry of stereo cameras, from whatever describes them."""

from mobilestereonet.data.rig.assumed import AssumedRig
from mobilestereonet.data.rig.cameras import Camera, CameraPair
from mobilestereonet.data.rig.description import Geometry
from mobilestereonet.data.rig.rig import Rig

__all__ = ["AssumedRig", "Camera", "CameraPair", "Geometry", "Rig"]
