# Public names of co.checkcases and where they are defined; lazy_loader and type checkers read this file.

from .check_case import CheckCase as CheckCase
from .comparison import Comparison as Comparison
from .registry import get as get
from .registry import names as names
from .tables import read_table as read_table
