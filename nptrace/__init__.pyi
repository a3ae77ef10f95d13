from cachesim.config import CacheConfig as CacheConfig
from nptrace.api import compare as compare
from nptrace.api import open as open
from nptrace.api import replay as replay
from nptrace.api import sweep as sweep
from nptrace.api import table1 as table1
from nptrace.api import time as time
from nptrace.drawing import Picture as Picture
from nptrace.drawing import map as map
from nptrace.drawing import plot as plot
from nptrace.drawing import report as report
from nptrace.drawing import view as view
from nptrace.results import Results as Results
from nptrace.summaries import combine as combine
from nptrace.summaries import summarise as summarise
from nptrace.tracing import estimate as estimate
from nptrace.tracing import render as render
from nptrace_base.errors import NptraceError as NptraceError
from traces.reader import Run as Run

__version__: str
