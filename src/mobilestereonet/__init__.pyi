from .data.calibration import read_calibration as read_calibration
from .data.rig import Rig as Rig
from .data.sample import Calibration as Calibration
from .data.sample import StereoSample as StereoSample
from .errors import InputError as InputError
from .inference import StereoMatcher as StereoMatcher
from .inference import StereoResult as StereoResult
from .nets import Prediction as Prediction
from .nets import StereoModel as StereoModel
from .nets import list_models as list_models
from .nets import register_model as register_model
from .streams import open_stream as open_stream
from .weights import create_model as create_model
from .weights import load_model as load_model
from .weights import save_pretrained as save_pretrained
from .weights import save_weights as save_weights

__version__: str
