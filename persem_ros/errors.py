"""The one exception that a user meets: what was wrong, what was expected, what to type."""


class PersemError(Exception):
    """
    A refusal in one sentence, fit to be shown to a user as it is.

    The command line prints it as one line and exits with status 1; the node logs it.

    """


PACKAGES = {'cv2': 'opencv-python-headless', 'yaml': 'pyyaml'}      # where pip's name is another
NEEDED = ('"numpy<2" numba rosbags opencv-python-headless lz4 pyyaml tqdm jinja2 trimesh '
          'embreex')


def missing(error: ImportError) -> str:
    """
    Return the sentence for a package that cannot be imported: which, and what to type.

    Raises
    ------
    ImportError
        Where it is one of our own modules that is missing: a defect.

    """
    name = (error.name or '').partition('.')[0]
    if name == 'persem_ros':
        raise error
    if name == 'rclpy' or name.endswith(('_msgs', '_srvs', '_interfaces')):
        return (f'the Python package {name} is missing, which comes with ROS 2: '
                'source /opt/ros/jazzy/setup.bash')
    if isinstance(error, ModuleNotFoundError) and name:
        package = PACKAGES.get(name, name)
        return (f'the Python package {package} is missing; with ROS 2: python3 -m venv '
                '--system-site-packages ~/persem-venv && source ~/persem-venv/bin/activate && '
                f'pip install {NEEDED}; without: pip install {package}')
    return (f'a Python package does not fit the others ({" ".join(str(error).split())[:200]}); '
            f'with ROS 2 Jazzy: pip install {NEEDED}')
