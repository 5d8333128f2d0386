"""Installs drfmcw_commissioning where ROS 2 looks for it."""

from setuptools import find_packages, setup

NAME = 'drfmcw_commissioning'

setup(
    name=NAME,
    version='0.1.0',
    packages=find_packages(exclude=['test', 'test.*']),
    package_data={NAME + '.survey': ['templates/*.html']},
    data_files=[
        ('share/ament_index/resource_index/packages', ['resource/' + NAME]),
        ('share/' + NAME, ['package.xml']),
    ],
    install_requires=['setuptools'],
    extras_require={'test': ['pytest']},
    zip_safe=True,
    maintainer='drfmcw maintainers',
    maintainer_email='drfmcw@example.com',
    description='From unpacked stations to a commissioned crane: calibration of the stations, on the bench and on site',
    license='Apache-2.0',
    entry_points={
        'console_scripts': [
            'calibrate = drfmcw_commissioning.calibrate:main',
            'survey = drfmcw_commissioning.survey.command:main',
        ],
    },
)
