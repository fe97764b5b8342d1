from wayloom.notebook import Drive as Drive
from wayloom.notebook import Map as Map
from wayloom.notebook import open_log as open_log
from wayloom.notebook import process as process

__version__: str
