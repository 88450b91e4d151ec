"""Ask `spikedeploy serve hexapod/sparse` for actions; needs pyzmq alone.

python examples/serve_client.py [tcp://127.0.0.1:5555]
"""

import json
import sys

import zmq

socket = zmq.Context().socket(zmq.REQ)
socket.connect(sys.argv[1] if len(sys.argv) > 1 else "tcp://127.0.0.1:5555")


def ask(**request: object) -> dict:
    """Return the reply to a request."""
    socket.send(json.dumps(request).encode())
    return json.loads(socket.recv())


observed = ask(do="info")["observations"]
ask(do="reset", seed=0)
print(ask(do="act", observation=[0.0] * observed, want=["spikes", "sops", "energy"]))
ask(do="bye")
