"""Installs drfmcw_sim where ROS 2 looks for it."""

from setuptools import find_packages, setup

NAME = 'drfmcw_sim'

setup(
    name=NAME,
    version='0.1.0',
    packages=find_packages(exclude=['test', 'test.*']),
    data_files=[
        ('share/ament_index/resource_index/packages', ['resource/' + NAME]),
        ('share/' + NAME, ['package.xml']),
    ],
    install_requires=['setuptools'],
    extras_require={'test': ['pytest']},
    zip_safe=True,
    maintainer='drfmcw maintainers',
    maintainer_email='drfmcw@example.com',
    description='Simulator of the cooperative FMCW radar: signal model, effects, scenario, node',
    license='Apache-2.0',
    entry_points={
        'console_scripts': [
            'simulator = drfmcw_sim.simulator:main',
            'simulate = drfmcw_sim.simulate:main',
        ],
    },
)
