from leactl.interface import Analysis as Analysis
from leactl.interface import Channel as Channel
from leactl.interface import Diagnosis as Diagnosis
from leactl.interface import Performed as Performed
from leactl.interface import Run as Run
from leactl.interface import Simulated as Simulated
from leactl.interface import analyze as analyze
from leactl.interface import diagnose as diagnose
from leactl.interface import open_run as open_run
from leactl.interface import run_protocol as run_protocol
from leactl.interface import simulate as simulate

__version__: str
INTERFACE: tuple[str, ...]
