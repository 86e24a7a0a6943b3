import pytest

pytest.register_assert_rewrite("tests.helpers")  # what fails in a helper is told as in a test
