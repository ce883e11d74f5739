"""What editors, type checkers and the documentation see of the names that `__init__.py` loads when first used."""

from ullage import worlds as worlds
from ullage.config import GuardSpec as GuardSpec
from ullage.data import Detections as Detections
from ullage.data import Frames as Frames
from ullage.data import Metric as Metric
from ullage.data import Trajectory as Trajectory
from ullage.errors import InputError as InputError
from ullage.errors import UllageError as UllageError
from ullage.errors import UllageWarning as UllageWarning
from ullage.experiments.dataset import dataset as dataset
from ullage.flight.missions import Waypoints as Waypoints
from ullage.flight.navigation import navigate as navigate
from ullage.flight.vehicle import fly as fly
from ullage.flight.vehicle import fly_log as fly_log
from ullage.geometry import C0 as C0
from ullage.grids import Grid as Grid
from ullage.grids import Image as Image
from ullage.grids import OccupancyMap as OccupancyMap
from ullage.pipeline import run as run
from ullage.pipeline import sink as sink
from ullage.ports.registry import open as open
from ullage.processing import metrics as metrics
from ullage.processing.calibrate import calibrate as calibrate
from ullage.processing.detect import detect as detect
from ullage.processing.guard import Guard as Guard
from ullage.processing.obstacles import ObstacleSectors as ObstacleSectors
from ullage.processing.obstacles import ObstacleStage as ObstacleStage
from ullage.processing.occupancy import map_occupancy as map_occupancy
from ullage.processing.own_echo import own_echo as own_echo
from ullage.processing.sar import focus as focus
from ullage.radar.explain import explain as explain
from ullage.radar.live import LiveRadars as LiveRadars
from ullage.radar.receiver_fit import Receiver as Receiver
from ullage.radar.simulate import simulate as simulate
from ullage.specs import AntennaSpec as AntennaSpec
from ullage.specs import MountSpec as MountSpec
from ullage.specs import NoiseSpec as NoiseSpec
from ullage.specs import RadarSpec as RadarSpec
from ullage.specs import Rig as Rig
from ullage.specs import ThesisSpec as ThesisSpec
from ullage.view import figures as figures
from ullage.world import scenes as scenes
from ullage.world.load import load_scene as load_scene
from ullage.world.scene import Scene as Scene

__version__: str
