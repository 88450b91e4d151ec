"""Ask `spikedeploy serve hexapod/sparse` for actions; needs pyzmq alone.

python examples/serve_client.py [tcp://127.0.0.1:5555]
"""

import json
import sys

import zmq

endpoint = sys.argv[1] if len(sys.argv) > 1 else "tcp://127.0.0.1:5555"


def ask(**request: object) -> dict:
    """Return the reply to a request; zmq.Again where none comes."""
    socket.send(json.dumps(request).encode())
    reply = json.loads(socket.recv())
    if not reply["ok"]:
        raise ConnectionError(reply["error"])
    return reply


for _ in range(5):  # without a reply the socket is of no use and the episode is lost
    with zmq.Context.instance().socket(zmq.REQ) as socket:
        socket.linger, socket.sndtimeo, socket.rcvtimeo = 0, 2000, 2000  # [ms]
        socket.connect(endpoint)
        try:
            observed = ask(do="info")["observations"]
            ask(do="reset", seed=0)
            print(ask(do="act", observation=[0.0] * observed))
            ask(do="bye")
            break
        except (zmq.Again, ConnectionError) as lost:
            print(f"connecting again: {lost}", file=sys.stderr)
else:
    sys.exit(f"{endpoint} does not answer")
