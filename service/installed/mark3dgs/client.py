"""The client of the service under the name that its users know; `service.client` has the code."""

from service.client import *  # noqa: F403  its names, whatever they become
from service.client import __all__ as __all__
