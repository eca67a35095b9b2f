within DockingHIL;
model CartesianResponse "Response of a robot to a commanded pose: pure delay and second order per axis, Eq. (17)"
  parameter Real omega_n[3](each quantity="AngularVelocity", each unit="rad/s", each displayUnit="Hz", each min=0) = fill(471.23889803846896, 3)
    "Undamped natural frequencies of the position along x, y, z (75 Hz)";
  parameter Real xi_n[3](each unit="1", each min=0) = fill(0.8, 3) "Damping ratios of the position";
  parameter Real rotation_omega_n[3](each quantity="AngularVelocity", each unit="rad/s", each displayUnit="Hz", each min=0) = fill(471.23889803846896, 3)
    "Undamped natural frequencies of the rotation vector about x, y, z (75 Hz)";
  parameter Real rotation_xi_n[3](each unit="1", each min=0) = fill(0.8, 3) "Damping ratios of the rotation vector";
  parameter Real tau_m(quantity="Time", unit="s", min=0) = 0.002 "Pure delay of the response";
  parameter Real reference_orientation[4](each unit="1") = {1, 0, 0, 0}
    "Orientation from which the rotation vector counts; a quaternion, scalar first";
  input Real position_command[3](each quantity="Length", each unit="m", each start=0) "Commanded position of O_u in O_t";
  input Real orientation_command[4](each unit="1", start={1, 0, 0, 0}) "Commanded orientation of O_u in O_t, scalar first";
  output Real position[3](each quantity="Length", each unit="m", each start=0, each fixed=true) "Position of O_u in O_t";
  output Real orientation[4](each unit="1") "Orientation of O_u in O_t, scalar first";
  output Real velocity[3](each quantity="Velocity", each unit="m/s", each start=0, each fixed=true)
    "Velocity of the origin of O_u, in O_t";
  output Real angular_velocity[3](each quantity="AngularVelocity", each unit="rad/s") "Angular velocity of O_u, in O_t";
  Real rotation_vector[3](each quantity="Angle", each unit="rad", each start=0, each fixed=true)
    "Rotation vector of O_u from the reference orientation";
  Real rotation_rate[3](each quantity="AngularVelocity", each unit="rad/s", each start=0, each fixed=true)
    "Rate of change of the rotation vector";
protected
  // Below this squared angle or sine, series replace the quotients that have no value at zero; the first
  // term left out is smaller than rounding.
  constant Real small(unit="1") = 1e-6 "Where series begin";
  Real reference_length(unit="1") "Length of the reference orientation, one but for rounding";
  Real r[4](each unit="1") "Reference orientation of length one";
  Real difference[4](each unit="1") "Turn from the reference to the command";
  Real sine2(unit="1") "Squared sine of half the commanded angle";
  Real sine(unit="1") "Sine of half the commanded angle, never zero";
  Real log_factor(unit="rad") "Rotation vector over the vector part of the quaternion";
  Real rotation_command[3](each unit="rad") "Commanded rotation vector";
  Real delayed_position[3](each unit="m") "Position command that reaches the servo now";
  Real delayed_rotation[3](each unit="rad") "Rotation command that reaches the servo now";
  Real angle2(unit="rad2") "Squared angle of the realised rotation";
  Real angle(unit="rad") "Angle of the realised rotation, never zero";
  Real cosine_half(unit="1") "Cosine of half the angle";
  Real sine_quotient(unit="1") "Sine of half the angle over the angle";
  Real first(unit="1") "(1 - cos angle)/angle^2";
  Real second(unit="1") "(angle - sin angle)/angle^3";
  Real turn[4](each unit="1") "Quaternion of the realised rotation";
  Real twist_1[3](each unit="rad/s") "rotation_vector x rotation_rate";
  Real twist_2[3](each unit="rad/s") "rotation_vector x twist_1";
  Real reference_rate[3](each unit="rad/s") "Angular velocity in the reference orientation's axes";
  Real across[3](each unit="rad/s") "2 r_vector x reference_rate";
equation
  for i in 1:3 loop
    delayed_position[i] = delay(position_command[i], tau_m);
    der(position[i]) = velocity[i];
    der(velocity[i]) = omega_n[i]^2*(delayed_position[i] - position[i]) - 2*xi_n[i]*omega_n[i]*velocity[i];
    delayed_rotation[i] = delay(rotation_command[i], tau_m);
    der(rotation_vector[i]) = rotation_rate[i];
    der(rotation_rate[i]) = rotation_omega_n[i]^2*(delayed_rotation[i] - rotation_vector[i])
      - 2*rotation_xi_n[i]*rotation_omega_n[i]*rotation_rate[i];
    rotation_command[i] = log_factor*difference[i + 1];
    turn[i + 1] = sine_quotient*rotation_vector[i];
  end for;
  reference_length = sqrt(reference_orientation*reference_orientation);
  r = reference_orientation/reference_length;

  // conj(r) * orientation_command
  difference[1] = r[1]*orientation_command[1] + r[2]*orientation_command[2] + r[3]*orientation_command[3] + r[4]*orientation_command[4];
  difference[2] = r[1]*orientation_command[2] - r[2]*orientation_command[1] - r[3]*orientation_command[4] + r[4]*orientation_command[3];
  difference[3] = r[1]*orientation_command[3] + r[2]*orientation_command[4] - r[3]*orientation_command[1] - r[4]*orientation_command[2];
  difference[4] = r[1]*orientation_command[4] - r[2]*orientation_command[3] + r[3]*orientation_command[2] - r[4]*orientation_command[1];

  // Logarithm: of the two quaternions of a turn, the one with the smaller angle counts.
  sine2 = difference[2]^2 + difference[3]^2 + difference[4]^2;
  sine = sqrt(noEvent(if sine2 < small then small else sine2));
  log_factor = noEvent(if sine2 < small then (2 - 2*sine2/(3*difference[1]^2) + 2*sine2^2/(5*difference[1]^4))/difference[1]
    else (if difference[1] < 0 then -2 else 2)*atan2(sine, abs(difference[1]))/sine);

  // Exponential.
  angle2 = rotation_vector*rotation_vector;
  angle = sqrt(noEvent(if angle2 < small then small else angle2));
  cosine_half = noEvent(if angle2 < small then 1 - angle2/8 + angle2^2/384 else cos(angle/2));
  sine_quotient = noEvent(if angle2 < small then 0.5 - angle2/48 + angle2^2/3840 else sin(angle/2)/angle);
  first = noEvent(if angle2 < small then 0.5 - angle2/24 + angle2^2/720 else (1 - cos(angle))/angle^2);
  second = noEvent(if angle2 < small then 1/6 - angle2/120 + angle2^2/5040 else (angle - sin(angle))/angle^3);
  turn[1] = cosine_half;
  orientation[1] = r[1]*turn[1] - r[2]*turn[2] - r[3]*turn[3] - r[4]*turn[4];
  orientation[2] = r[1]*turn[2] + r[2]*turn[1] + r[3]*turn[4] - r[4]*turn[3];
  orientation[3] = r[1]*turn[3] - r[2]*turn[4] + r[3]*turn[1] + r[4]*turn[2];
  orientation[4] = r[1]*turn[4] + r[2]*turn[3] - r[3]*turn[2] + r[4]*turn[1];

  // Angular velocity in the reference's axes, then turned by the reference: v + w a + r_vector x a.
  twist_1[1] = rotation_vector[2]*rotation_rate[3] - rotation_vector[3]*rotation_rate[2];
  twist_1[2] = rotation_vector[3]*rotation_rate[1] - rotation_vector[1]*rotation_rate[3];
  twist_1[3] = rotation_vector[1]*rotation_rate[2] - rotation_vector[2]*rotation_rate[1];
  twist_2[1] = rotation_vector[2]*twist_1[3] - rotation_vector[3]*twist_1[2];
  twist_2[2] = rotation_vector[3]*twist_1[1] - rotation_vector[1]*twist_1[3];
  twist_2[3] = rotation_vector[1]*twist_1[2] - rotation_vector[2]*twist_1[1];
  reference_rate = rotation_rate + first*twist_1 + second*twist_2;
  across[1] = 2*(r[3]*reference_rate[3] - r[4]*reference_rate[2]);
  across[2] = 2*(r[4]*reference_rate[1] - r[2]*reference_rate[3]);
  across[3] = 2*(r[2]*reference_rate[2] - r[3]*reference_rate[1]);
  angular_velocity[1] = reference_rate[1] + r[1]*across[1] + r[3]*across[3] - r[4]*across[2];
  angular_velocity[2] = reference_rate[2] + r[1]*across[2] + r[4]*across[1] - r[2]*across[3];
  angular_velocity[3] = reference_rate[3] + r[1]*across[3] + r[2]*across[2] - r[3]*across[1];
  assert(reference_length > 0.999 and reference_length < 1.001, "reference_orientation has to be a quaternion (w, x, y, z) of length 1, within 0.001; no turn is (1, 0, 0, 0)");
end CartesianResponse;
