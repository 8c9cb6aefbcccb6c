import pytest

from poise.estimate.profiles import (
    ComponentProfile,
    ConnectorProfile,
    Costs,
    Distribution,
    KindCosts,
    Profile,
    TimerProfile,
)
from poise.model.robot import (
    Architecture,
    ComponentEntry,
    Computer,
    Connector,
    ConnectorEnd,
    Robot,
)

JOINED = Connector(
    between=(ConnectorEnd("eye", "image"), ConnectorEnd("mind", "image"))
)


@pytest.fixture
def robot() -> Robot:
    """Two computers; an eye that publishes to a mind, whose CPU the file gives."""
    return Robot(
        name="r",
        computers=(
            Computer(name="a", capacity={"cpu": 1.0, "memory": 1e9}),
            Computer(name="b", capacity={"cpu": 1.0, "memory": 1e9}),
        ),
        architectures=(
            Architecture(
                name="see",
                function="seeing",
                components=(
                    ComponentEntry(name="eye"),
                    ComponentEntry(name="mind", demand={"cpu": 0.5}),
                ),
                connectors=(JOINED,),
            ),
        ),
    )


@pytest.fixture
def profile() -> Profile:
    return Profile(
        robot="r",
        poise="0.1.0",
        computer="a",
        speed=0.5,
        at="2026-01-01T00:00:00+00:00",
        seconds=30.0,
        agent=0.01,
        components={
            "eye": ComponentProfile(
                version="1",
                cpu=Distribution(mean=0.1, sustained=0.12, peak=0.4, windows=300),
                share=0.02,
                memory=8e6,
                base=2e6,
                state=100.0,
                timers={
                    "look": TimerProfile(
                        period=0.1, median=0.01, p99=0.02, maximum=0.03
                    )
                },
            ),
            "mind": ComponentProfile(
                version="2", cpu=Distribution(mean=0.3, sustained=0.3), memory=4e6
            ),
        },
        connectors={str(JOINED): ConnectorProfile(messages=10.0, size=1000.0)},
        costs={
            "direct": KindCosts(source=Costs(message=2e-5)),
            "local": KindCosts(
                source=Costs(message=3e-5), target=Costs(message=2e-5, byte=1e-9)
            ),
            "remote": KindCosts(
                source=Costs(call=3e-4, message=9e-5, byte=1e-8),
                target=Costs(call=1e-4, message=3e-5, byte=1e-8),
            ),
        },
    )
