"""Skip a test module where the packages that build FMUs are not installed."""

import pytest

for _name in ("rumoca", "casadi", "ziglang"):
    pytest.importorskip(_name, reason=f"{_name} is not installed: pip install 'orchestrator[build]'")
