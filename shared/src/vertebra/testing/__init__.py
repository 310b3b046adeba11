"""Suites and helpers for the tests of Vertebra and of everything that plugs into it."""
