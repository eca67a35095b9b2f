within DockingHIL;
model JointServos "Joint servos of an arm on a rail: pure delay and second order per axis, Eq. (17); encoders"
  parameter Real omega_n[7](each quantity="AngularVelocity", each unit="rad/s", each displayUnit="Hz", each min=0) = fill(471.23889803846896, 7)
    "Undamped natural frequencies, rail first (75 Hz)";
  parameter Real xi_n[7](each unit="1", each min=0) = fill(0.8, 7) "Damping ratios, rail first";
  parameter Real tau_m(quantity="Time", unit="s", min=0) = 0.002 "Pure delay of the response";
  parameter Real rail_resolution(quantity="Length", unit="m", min=0) = 0 "Step of the rail's encoder; 0 m: not rounded";
  parameter Real angle_resolution(quantity="Angle", unit="rad", min=0) = 0
    "Step of the encoders of A1 to A6, seen at the joint; 0 rad: not rounded";
  input Real joint_command[7](unit={"m", "rad", "rad", "rad", "rad", "rad", "rad"}, start=start_joints)
    "Commanded positions of the rail and A1 to A6";
  output Real joint_position[7](unit={"m", "rad", "rad", "rad", "rad", "rad", "rad"}, start=start_joints, each fixed=true)
    "Positions of the rail and A1 to A6";
  output Real joint_velocity[7](unit={"m/s", "rad/s", "rad/s", "rad/s", "rad/s", "rad/s", "rad/s"}, each start=0, each fixed=true)
    "Velocities of the rail and A1 to A6";
  output Real measured_position[7](unit={"m", "rad", "rad", "rad", "rad", "rad", "rad"})
    "Positions as the encoders read them";
protected
  constant Real start_joints[7](unit={"m", "rad", "rad", "rad", "rad", "rad", "rad"}) = {0, 0, -1.7453292519943295, 2.2689280275926285, 0, -0.5235987755982988, 0}
    "Joints that ArmInverse commands at the start unless it is told otherwise";
  Real delayed_command[7](unit={"m", "rad", "rad", "rad", "rad", "rad", "rad"}) "Commands that reach the servos now";
  Real step[7](unit={"m", "rad", "rad", "rad", "rad", "rad", "rad"}) "Steps of the encoders";
equation
  for i in 1:7 loop
    delayed_command[i] = delay(joint_command[i], tau_m);
    der(joint_position[i]) = joint_velocity[i];
    der(joint_velocity[i]) = omega_n[i]^2*(delayed_command[i] - joint_position[i]) - 2*xi_n[i]*omega_n[i]*joint_velocity[i];
    step[i] = if i == 1 then rail_resolution else angle_resolution;
    // noEvent: rounding is a property of the reading, not of the motion.
    measured_position[i] = noEvent(if step[i] > 0 then step[i]*floor(joint_position[i]/step[i] + 0.5) else joint_position[i]);
  end for;
end JointServos;
