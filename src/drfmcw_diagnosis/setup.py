"""Installs drfmcw_diagnosis where ROS 2 looks for it."""

from setuptools import find_packages, setup

NAME = 'drfmcw_diagnosis'

setup(
    name=NAME,
    version='0.1.0',
    packages=find_packages(exclude=['test', 'test.*']),
    package_data={NAME + '.finding': ['templates/*.html'], NAME + '.several': ['templates/*.html']},
    data_files=[
        ('share/ament_index/resource_index/packages', ['resource/' + NAME]),
        ('share/' + NAME, ['package.xml']),
    ],
    install_requires=['setuptools'],
    extras_require={'test': ['pytest']},
    zip_safe=True,
    maintainer='drfmcw maintainers',
    maintainer_email='drfmcw@example.com',
    description='Finds what physics the model of a recording leaves out',
    license='Apache-2.0',
    entry_points={
        'console_scripts': [
            'diagnose = drfmcw_diagnosis.diagnose:main',
            'watch = drfmcw_diagnosis.live.node:main',
        ],
    },
)
