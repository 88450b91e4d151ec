"""The text of icebox_vlog, with each port declared once, so that simulators read it.

    python3 decompiled.py < FILE > FILE

It names all ports in the header of the module, and again among its wires and registers.
"""

import re
import sys


def declare_once(text: str) -> str:
    """The module without the second declarations of its ports."""
    header = re.search(r"module \w+ \(([^)]*)\);", text)
    if header is None:
        raise SystemExit("decompiled.py: there is no module in the text of icebox_vlog")
    ports = {each.split()[-1]: each.strip() for each in header[1].split(",") if each.strip()}
    lines = []
    for line in text.splitlines():
        kind, _, rest = line.partition(" ")
        if kind in ("wire", "reg") and rest.endswith(";") and "(" not in rest:
            names = [each.strip() for each in rest.rstrip(";").split(",")]
            for name in names:
                port = name.split("=")[0].strip()
                if kind == "reg" and port in ports:
                    ports[port] = f"output reg {name}"
            names = [each for each in names if each.split("=")[0].strip() not in ports]
            line = f"{kind} {', '.join(names)};" if names else ""
        lines.append(line)
    body = "\n".join(lines) + "\n"
    return body.replace(header[1], ", ".join(ports.values()), 1)


if __name__ == "__main__":
    sys.stdout.write(declare_once(sys.stdin.read()))
