"""gsply with its kernels as plain Python: compiling them takes longer than all their calls here."""

import sys

import gsply
import gsply.gsdata
from gsply import sog_reader, spz
from numba.core.dispatcher import Dispatcher

__all__ = ["gsply", "sog_reader", "spz"]

for _name, _module in list(sys.modules.items()):
    if _name.split(".")[0] == "gsply":
        for _each, _value in list(vars(_module).items()):
            if isinstance(_value, Dispatcher):
                setattr(_module, _each, _value.py_func)
