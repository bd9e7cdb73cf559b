"""Imported by every process of a service that a test starts with `lean=True`: there the profile "fast" looks at three
small views and makes few landmarks, so that an embedding takes a fourth of its time. Such records know few pictures."""

import sys
from collections.abc import Sequence
from dataclasses import replace
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec
from importlib.util import find_spec
from types import ModuleType

_PROFILES = "engine.flows.embed.profiles"


class _LeanProfiles(MetaPathFinder):
    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if fullname != _PROFILES:
            return None
        sys.meta_path.remove(self)
        found = find_spec(fullname)
        assert found is not None
        assert found.loader is not None
        load = found.loader.exec_module

        def exec_module(module: ModuleType) -> None:
            load(module)
            module.PROFILES["fast"] = replace(module.PROFILES["fast"], views=3, view_size=256, landmark_views=4)

        found.loader.exec_module = exec_module  # type: ignore[method-assign]
        return found


sys.meta_path.insert(0, _LeanProfiles())
