"""The machine behind the target in Python: motor axes, linear, exact and the same in every run."""

from dataclasses import dataclass, field

MASK = (1 << 64) - 1


@dataclass
class Noise:
    """SplitMix64: uniform numbers in -1 .. 1 from a state of 64 bits."""

    state: int = 1

    def draw(self) -> float:
        self.state = (self.state + 0x9E3779B97F4A7C15) & MASK
        mixed = self.state
        mixed = ((mixed ^ (mixed >> 30)) * 0xBF58476D1CE4E5B9) & MASK
        mixed = ((mixed ^ (mixed >> 27)) * 0x94D049BB133111EB) & MASK
        return ((mixed ^ (mixed >> 31)) >> 11) * (2.0 / (1 << 53)) - 1.0


@dataclass
class Axes:
    """Motor axes: `v[k+1] = decay v[k] + gain w[k]`, `x[k+1] = x[k] + v[k] / rate_hz`, w the commands mixed.

    Command j acts on axis i by `coupling` where they differ. Sensors are the positions in rad with uniform noise.
    Whatever position is an equilibrium with commands at zero.
    """

    count: int = 1
    rate_hz: float = 1000.0
    decay: float = 0.97
    gain: float = 0.4
    coupling: float = 0.0
    noise_rad: float = 1e-4
    noise: Noise = field(default_factory=Noise)
    position: list[float] = field(default_factory=list)
    speed: list[float] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.place([0.0] * self.count)

    @property
    def sensors(self) -> list[str]:
        return [f"angle{i + 1}_rad" for i in range(self.count)]

    @property
    def commands(self) -> list[str]:
        return [f"drive{i + 1}_v" for i in range(self.count)]

    @property
    def ranges(self) -> list[tuple[float, float]]:
        """Lowest and highest value of each sensor, then of each command."""
        return [(-7.0, 7.0)] * self.count + [(-100.0, 100.0)] * self.count

    def place(self, position: list[float]) -> None:
        """At rest there."""
        self.position, self.speed = list(position), [0.0] * self.count

    def read(self) -> list[float]:
        """The sensors now; each reading draws its noise."""
        return [x + self.noise_rad * self.noise.draw() for x in self.position]

    def move(self, u: list[float]) -> None:
        """One tick on with these commands."""
        for i in range(self.count):
            drive = u[i]
            for j in range(self.count):
                if j != i:
                    drive = drive + self.coupling * u[j]
            self.position[i] = self.position[i] + self.speed[i] / self.rate_hz
            self.speed[i] = self.decay * self.speed[i] + self.gain * drive

    def response(self, z: complex, output: int, command: int) -> complex:
        """Position over command at `z = exp(j w / rate_hz)`."""
        share = 1.0 if output == command else self.coupling
        return share * self.gain / self.rate_hz / ((z - 1.0) * (z - self.decay))
