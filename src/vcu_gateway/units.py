"""Units of time: nanoseconds in a microsecond, a millisecond and a second."""

NS_PER_US = 1_000
NS_PER_MS = 1_000_000
NS_PER_S = 1_000_000_000
