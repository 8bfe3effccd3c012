"""The package as colcon builds it; mapweave itself, with its extra `live`, is installed beside it."""

from setuptools import setup

NAME = "mapweave_ros"

setup(
    name=NAME,
    version="0.4.0",
    packages=[NAME],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/launch", ["launch/live.launch.py"]),
    ],
    install_requires=["setuptools"],
    zip_safe=True,
    author="The mapweave authors",
    description="One map of ROS 2 robots while they drive, by mapweave over Zenoh.",
    license="Apache-2.0",
    entry_points={"console_scripts": ["mapweave = mapweave.cli:main"]},
)
