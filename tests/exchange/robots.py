"""Robots as MJCF and URDF that the tests of this folder read and change."""

LEG = """\
<mujoco model="leg">
  <!-- a leg on a bench -->
  <compiler angle="radian"/>
  <option timestep="{timestep}" integrator="implicitfast"/>
  <default><joint damping="0.05"/></default>
  <worldbody>
    <body name="thigh">
      <!-- the knee's figures are the maker's -->
      <joint name="knee" type="hinge" axis="0 1 0" armature="0.01" frictionloss="0.2"
             range="-2 2"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="0.6"/>
    </body>
  </worldbody>
  <actuator>
    {actuator} <!-- by hand -->
  </actuator>
</mujoco>
"""
SERVO = '<position name="servo" joint="knee" kp="15" kv="0.6" forcerange="-8 8"/>'
MOTOR = '<motor name="motor" joint="knee" gear="1.8" ctrlrange="-4 4"/>'

CHAIN = """\
<mujoco>
  <worldbody>
    <body name="trunk" pos="0 0 1">{trunk}
      <geom size="0.1" mass="3"/>
      <body name="thigh">
        <joint name="hip" axis="0 1 0"{hip}/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="0.6"/>
        <body name="shank" pos="0 0 -0.3">
          <joint name="knee" axis="0 1 0" pos="0 0 0.0"{knee}/>
          <geom type="capsule" fromto="0 0 0 0 0 -0.25" size="0.02" mass="0.3"/>
          <site name="foot" pos="0 0 -0.25"/>
        </body>
      </body>
    </body>
    <body name="wall"><geom size="0.1"/><site name="hook"/></body>
  </worldbody>
  {more}
</mujoco>
"""

URDF = """\
<?xml version="1.0"?>
<robot name="arm">
  <link name="base"/>
  <link name="forearm">
    <inertial>
      <origin xyz="0.2 0 0"/> <mass value="1.5"/>
      <inertia ixx="0.001" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/>
    </inertial>
    <visual><geometry><mesh filename="package://arm/not-there.stl"/></geometry></visual>
    <collision><geometry><mesh filename="package://arm/not-there.stl"/></geometry></collision>
  </link>
  <!-- the elbow turns a forearm that stands out level -->
  <joint name="elbow" type="revolute">
    <parent link="base"/> <child link="forearm"/>
    <axis xyz="0 1 0"/>
    <limit lower="-1" upper="1" effort="12" velocity="3"/>{dynamics}
  </joint>
</robot>
"""


def leg(folder, actuator=SERVO, timestep="0.0005", name="robot.xml"):
    """A leg of one joint with an actuator, as a file."""
    return written(folder / name, LEG.format(actuator=actuator, timestep=timestep))


def chain(folder, trunk="", hip="", knee="", more=""):
    """A trunk with a hip and a knee, as a file."""
    return written(folder / "chain.xml", CHAIN.format(trunk=trunk, hip=hip, knee=knee, more=more))


def arm(folder, dynamics='<dynamics damping="0.1" friction="0.2"/>'):
    """An arm of one joint as URDF."""
    return written(folder / "arm.urdf", URDF.format(dynamics=dynamics))


def written(path, text):
    path.write_text(text, encoding="utf-8")
    return path
