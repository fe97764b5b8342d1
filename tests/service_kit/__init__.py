"""What the tests of the service share: a real service in its own processes, with small stages, and made-up drives for it."""

import pkgutil

import pytest

# What they assert is told with its values, as in a test.
pytest.register_assert_rewrite(*(f"{__name__}.{module.name}" for module in pkgutil.iter_modules(__path__)))
