# The node and the command line on ROS 2 Jazzy.
#   docker build -t persem_ros .
#   docker run --rm --net host --ipc host persem_ros                              the node
#   docker run --rm -v "$PWD:/data" persem_ros persem replay /data/bag --out /data/result
FROM ros:jazzy-ros-base

RUN apt-get update \
 && DEBIAN_FRONTEND=noninteractive apt-get install -y --no-install-recommends \
      python3-venv python3-pytest python3-jinja2 python3-opencv python3-tqdm python3-yaml \
      ros-jazzy-rmw-cyclonedds-cpp ros-jazzy-rosbag2-storage-mcap \
      ros-jazzy-ament-flake8 ros-jazzy-ament-pep257 ros-jazzy-ament-xmllint libxml2-utils \
 && rm -rf /var/lib/apt/lists/*

# Ubuntu has no package for these and its pip does not install beside apt: an environment that sees
# the system's packages, with the NumPy for which the messages of Jazzy are built. COLCON_IGNORE
# keeps colcon from looking for packages inside.
RUN python3 -m venv --system-site-packages /opt/venv \
 && touch /opt/venv/COLCON_IGNORE \
 && /opt/venv/bin/pip install --no-cache-dir 'numpy<2' 'numba>=0.60' 'rosbags>=0.11.9' \
      'trimesh>=4.4' hypothesis \
 && if [ "$(uname -m)" = x86_64 ]; then /opt/venv/bin/pip install --no-cache-dir 'embreex>=2.17.7'; fi
ENV VIRTUAL_ENV=/opt/venv PATH=/opt/venv/bin:$PATH

COPY . /workspace/src/persem_ros
WORKDIR /workspace
RUN . /opt/ros/jazzy/setup.sh && python3 -m colcon build --packages-select persem_ros \
 && . install/setup.sh && python3 -c 'from persem_ros.core.warmup import warm_up; warm_up()'

# The base image's entry point knows /opt/ros only.
RUN printf '%s\n' '#!/bin/bash' 'set -e' 'source /opt/ros/jazzy/setup.bash' \
      'source /workspace/install/setup.bash' 'export PATH=/workspace/install/persem_ros/lib/persem_ros:$PATH' \
      'exec "$@"' > /entrypoint.sh && chmod +x /entrypoint.sh
ENTRYPOINT ["/entrypoint.sh"]
CMD ["ros2", "run", "persem_ros", "mapper"]
