"""What one would write first: `python -m bench.naive [silent] [stand-in=FD]`, until SIGTERM.

Notifier, decode_message, a dictionary and time.sleep. `silent`: it receives only, and says when.
"""

import sys
import time
from typing import Any, NoReturn

import can
import cantools

from bench import CHANNEL, DBC, stand_in


def main() -> NoReturn:
    options = dict(word.partition("=")[::2] for word in sys.argv[1:])
    if "stand-in" in options:
        stand_in.for_python_can(int(options["stand-in"]))
    db: Any = cantools.database.load_file(DBC)
    state: dict[int, Any] = {}

    def on_message(msg: can.Message) -> None:
        state[msg.arbitration_id] = db.decode_message(msg.arbitration_id, msg.data)

    commands = [db.get_message_by_name(f"VCU_PCU{n}_Command") for n in (1, 2)]
    values = {signal.name: 0 for signal in commands[0].signals} | {"SpeedLimit": 12000}
    with can.Bus(interface="socketcan", channel=CHANNEL) as bus:
        can.Notifier(bus, [on_message])
        if "silent" in options:
            print("ready", flush=True)
            time.sleep(1e6)
        while True:
            for command in commands:
                bus.send(
                    can.Message(
                        arbitration_id=command.frame_id,
                        data=command.encode(values),
                        is_extended_id=True,
                    )
                )
            time.sleep(0.05)


if __name__ == "__main__":
    main()
