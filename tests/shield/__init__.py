"""Tests of `shield`: they need only the dependencies of `shield` and the test extra."""
