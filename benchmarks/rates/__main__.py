"""Check all rates, and print them: `python -m benchmarks.rates`.  One beyond its limit is an error."""

from benchmarks.rates import noise, rubbing_torque, torque

if __name__ == "__main__":
    noise.check()
    torque.check()
    rubbing_torque.check_small_loads()
    rubbing_torque.check_large_loads()
