#!/usr/bin/env bash
# Installs Safety-Gymnasium 1.0.0 in a virtual environment of its own, for the real tasks:
#
#     scripts/install_safety_gymnasium.sh FOLDER
#     export DEAD_ENDS_SAFETY_PYTHON=FOLDER/bin/python
#
# Its own pins have no wheels for Python 3.11, so versions that work together are installed
# without asking it. Rendering needs EGL: libegl1 libegl-mesa0 libgl1-mesa-dri on Debian.
set -euo pipefail
[ "$#" -eq 1 ] || { echo "usage: $0 FOLDER" >&2; exit 2; }
python3 -m venv "$1"
"$1/bin/pip" install --quiet numpy==2.3.5 mujoco==3.17.0 glfw pyopengl pygame xmltodict pyyaml \
  imageio cloudpickle farama-notifications jinja2 typing-extensions
"$1/bin/pip" install --quiet --no-deps gymnasium==0.29.1 gymnasium-robotics==1.2.4 \
  pettingzoo==1.24.3 safety-gymnasium==1.0.0
"$1/bin/python" - <<'PYTHON'
import mujoco, numpy
print(f"Safety-Gymnasium 1.0.0 with MuJoCo {mujoco.__version__} and numpy {numpy.__version__}")
PYTHON
