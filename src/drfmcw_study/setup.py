"""Installs drfmcw_study where ROS 2 looks for it."""

from setuptools import find_packages, setup

NAME = 'drfmcw_study'

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
    description='The whole chain offline: Monte Carlo and the figures of the paper',
    license='Apache-2.0',
    entry_points={
        'console_scripts': [
            'montecarlo = drfmcw_study.monte_carlo:main',
            'reproduce = drfmcw_study.reproduce:main',
        ],
    },
)
