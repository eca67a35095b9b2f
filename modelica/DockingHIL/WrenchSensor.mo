within DockingHIL;
model WrenchSensor "Six-axis force/torque sensor: lever, tool weight, pure delay, low-pass, noise, resolution"
  parameter Real sensor_position[3](each quantity="Length", each unit="m") = {0, 0, 0} "Origin of O_sg in O_t";
  parameter Real sensor_orientation[4](each unit="1") = {1, 0, 0, 0}
    "Orientation of O_sg in O_t, unit quaternion w, x, y, z";
  parameter Real tau_s(quantity="Time", unit="s", min=0) = 0 "Pure measurement delay";
  parameter Real cutoff(quantity="Frequency", unit="Hz", min=0) = 0 "Cut-off frequency of the low-pass; 0 Hz: no low-pass";
  parameter Real force_resolution(quantity="Force", unit="N", min=0) = 0 "Step of the force reading; 0 N: not rounded";
  parameter Real torque_resolution(quantity="Torque", unit="N.m", min=0) = 0 "Step of the torque reading; 0 N.m: not rounded";
  parameter Real tool_mass(quantity="Mass", unit="kg", min=0) = 0 "Mass that the sensor carries: the frame";
  parameter Real tool_center[3](each quantity="Length", each unit="m") = {0, 0, 0} "Its centre of mass in O_sg";
  parameter Real gravity[3](each quantity="Acceleration", each unit="m/s2") = {0, 0, -9.80665} "Gravity in O_t";
  parameter Boolean tared = true "Whether the weight has been subtracted from the reading";
  input Real force[3](each quantity="Force", each unit="N", each start=0) "Contact force on the rod, in O_t";
  input Real point[3](each quantity="Length", each unit="m", each start=0) "Point where it acts, in O_t";
  input Real force_noise[3](each quantity="Force", each unit="N", each start=0) "Noise of the force reading";
  input Real torque_noise[3](each quantity="Torque", each unit="N.m", each start=0) "Noise of the torque reading";
  output Real measured_force[3](each quantity="Force", each unit="N") "Reading: force on the rod, in O_sg";
  output Real measured_torque[3](each quantity="Torque", each unit="N.m")
    "Reading: moment of the force on the rod about the origin of O_sg, in O_sg";
protected
  constant Real two_pi(unit="rad") = 6.283185307179586;
  parameter Real w(unit="1") = sensor_orientation[1] "Scalar part of the rotation";
  parameter Real u[3](each unit="1") = -sensor_orientation[2:4] "Vector part of the inverse rotation";
  parameter Real weight[3](each quantity="Force", each unit="N") =
    if tared then {0, 0, 0} else tool_mass*gravity "Weight in the reading, in O_t";
  parameter Real tool_weight[3](each quantity="Force", each unit="N") =
    2*(u*weight)*u + (w^2 - u*u)*weight + 2*w*cross(u, weight) "The same, in O_sg";
  parameter Real tool_torque[3](each quantity="Torque", each unit="N.m") = cross(tool_center, tool_weight) "Its moment";
  Real moment[3](each quantity="Torque", each unit="N.m") "Moment about the origin of O_sg, in O_t";
  Real sensed_force[3](each quantity="Force", each unit="N") "Force in O_sg";
  Real sensed_torque[3](each quantity="Torque", each unit="N.m") "Moment in O_sg";
  Real delayed_force[3](each quantity="Force", each unit="N") "Force that reaches the filter now";
  Real delayed_torque[3](each quantity="Torque", each unit="N.m") "Moment that reaches the filter now";
  Real filtered_force[3](each quantity="Force", each unit="N", each start=0, each fixed=true) "State of the low-pass";
  Real filtered_torque[3](each quantity="Torque", each unit="N.m", each start=0, each fixed=true) "State of the low-pass";
  Real analog_force[3](each quantity="Force", each unit="N") "Reading before rounding";
  Real analog_torque[3](each quantity="Torque", each unit="N.m") "Reading before rounding";
equation
  moment = cross(point - sensor_position, force);
  sensed_force = 2*(u*force)*u + (w^2 - u*u)*force + 2*w*cross(u, force);
  sensed_torque = 2*(u*moment)*u + (w^2 - u*u)*moment + 2*w*cross(u, moment);
  for i in 1:3 loop
    delayed_force[i] = delay(sensed_force[i], tau_s);
    delayed_torque[i] = delay(sensed_torque[i], tau_s);
    der(filtered_force[i]) = two_pi*cutoff*(delayed_force[i] - filtered_force[i]);
    der(filtered_torque[i]) = two_pi*cutoff*(delayed_torque[i] - filtered_torque[i]);
    // The frame hangs on the sensor: its weight pulls at the frame, so it counts negative in a reading that is
    // the force on the rod.
    analog_force[i] = (if cutoff > 0 then filtered_force[i] else delayed_force[i]) - tool_weight[i] + force_noise[i];
    analog_torque[i] = (if cutoff > 0 then filtered_torque[i] else delayed_torque[i]) - tool_torque[i] + torque_noise[i];
    // noEvent: as in ForceSensor, rounding is a property of the reading, not of the motion.
    measured_force[i] = noEvent(
      if force_resolution > 0 then force_resolution*floor(analog_force[i]/force_resolution + 0.5) else analog_force[i]);
    measured_torque[i] = noEvent(
      if torque_resolution > 0 then torque_resolution*floor(analog_torque[i]/torque_resolution + 0.5) else analog_torque[i]);
  end for;
  assert(abs(sensor_orientation*sensor_orientation - 1) < 1e-9,
    "sensor_orientation is no unit quaternion; give w, x, y, z of length 1");
  annotation (Documentation(info="<html>
<p>The contact force acts on the rod at a point; the sensor sees it with its moment about its own origin,
in its own axes (Eq. 2 of the source), tau_s late, through a first-order low-pass, with noise, rounded. Each
part is absent when its parameter is zero.</p>
<p>The frame that the sensor carries does not move, so its weight is a constant: subtracted
(<code>tared</code>), or a bias of the reading.</p>
</html>"));
end WrenchSensor;
