"""Installation: `pip install .` gives the command line, colcon the ROS 2 package."""

from glob import glob

from setuptools import find_packages, setup

NAME = 'persem_ros'

setup(
    name=NAME,
    version='0.1.0',
    description='Persistent semantic memory for robots: stable labels and a voxel map',
    author='persem_ros maintainers',
    maintainer='persem_ros maintainers',
    maintainer_email='persem_ros@users.noreply.github.com',
    license='Apache-2.0',
    packages=find_packages(include=[NAME, f'{NAME}.*']),
    package_data={NAME: ['py.typed'],
                  f'{NAME}.outputs.report': ['assets/*', 'templates/*'],
                  f'{NAME}.outputs.view': ['assets/*'],
                  f'{NAME}.evaluate.show': ['templates/*']},
    python_requires='>=3.10',
    install_requires=[
        'jinja2>=3.1',
        'lz4>=4',
        'numba>=0.60',
        'numpy>=1.26',
        'opencv-python-headless>=4.8',
        'pyyaml>=6',
        'rosbags>=0.11.9',
        'tqdm>=4.60',
        # The simulated flight only. Embree has no wheels for Linux on ARM, where the other
        # commands do without it.
        'trimesh>=4.4',
        'embreex>=2.17.7; sys_platform != "linux" or platform_machine == "x86_64"',
    ],
    extras_require={
        # laspy and lazrs are small; what needs more of gis is skipped without it.
        'test': ['distributed>=2024.1', 'hypothesis>=6.100', 'laspy>=2.5', 'lazrs>=0.6',
                 'matplotlib>=3.7', 'pytest>=8', 'pytest-xdist>=3.8', 'scikit-learn>=1.4',
                 'setuptools>=70.1'],
        'lint': ['flake8>=7', 'flake8-blind-except', 'flake8-builtins', 'flake8-class-newline',
                 'flake8-comprehensions', 'flake8-deprecated', 'flake8-docstrings',
                 'flake8-import-order', 'flake8-quotes', 'mypy', 'pydocstyle',
                 'types-PyYAML', 'types-tqdm'],
        'bench': ['octomap-python>=1.8', 'open3d>=0.18', 'psutil>=5.9'],
        'cluster': ['distributed>=2024.1'],
        'docs': ['myst-parser>=3', 'sphinx>=7', 'sphinx-rtd-theme>=2'],
        'evaluate': ['matplotlib>=3.7'],
        'gis': ['laspy>=2.5', 'lazrs>=0.6', 'pyarrow>=15', 'pyproj>=3.6', 'rasterio>=1.3'],
        'viewer': ['rerun-sdk>=0.23'],
    },
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{NAME}']),
        (f'share/{NAME}', ['package.xml']),
        (f'share/{NAME}/config', sorted(glob('config/*.*'))),
        (f'share/{NAME}/config/labels', sorted(glob('config/labels/*.yaml'))),
        (f'share/{NAME}/launch', sorted(glob('launch/*.launch.py'))),
    ],
    zip_safe=False,
    entry_points={'console_scripts': ['persem = persem_ros.cli:main',
                                      'mapper = persem_ros.ros.start:main']},
)
