from setuptools import setup

setup(
    name="mapshift_node",
    version="0.1.0",
    packages=["mapshift_node"],
    # The gateway of examples/gateway, by links: copy this directory with `cp -rL`.
    py_modules=["mapshift_gateway", "mapshift_odometry", "mapshift_spool", "mapshift_uploader"],
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/mapshift_node"]),
        ("share/mapshift_node", ["package.xml"]),
        ("share/mapshift_node/launch", ["launch/mapshift.launch.py"]),
        ("share/mapshift_node/config", ["config/mapshift.yaml"]),
    ],
    install_requires=["setuptools"],
    zip_safe=True,
    description="Sends a vehicle's laser scans with their odometry to mapshift",
    license="Apache-2.0",
    entry_points={"console_scripts": ["mapshift_node = mapshift_node.node:main"]},
)
