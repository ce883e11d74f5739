"""The ament package: entry points and files; the work is in the Python package ullage."""

from glob import glob

from setuptools import setup

NAME = "ullage_ros"

setup(
    name=NAME,
    version="0.1.0",
    packages=[NAME],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/launch", glob("launch/*.launch.py")),
        (f"share/{NAME}/config", glob("config/*")),
        (f"share/{NAME}/urdf", glob("urdf/*.urdf")),
    ],
    install_requires=["setuptools", "ullage"],
    zip_safe=True,
    maintainer="The ullage developers",
    maintainer_email="ullage@users.noreply.github.com",
    description="Simulates and maps ultra-wideband radars on drones in closed spaces.",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            f"radar_simulator = {NAME}.nodes:radar_simulator",
            f"radar_mapping = {NAME}.nodes:radar_mapping",
            f"gazebo_server = {NAME}.gazebo:server",
            f"gazebo_pilot = {NAME}.gazebo:pilot",
        ],
    },
)
