within DockingHIL;
model RobotResponse "Position response of an industrial robot: pure delay and second order, Eq. (17)"
  parameter Real omega_n(quantity="AngularVelocity", unit="rad/s", displayUnit="Hz", min=0) = 471.23889803846896
    "Undamped natural frequency (75 Hz)";
  parameter Real xi_n(unit="1", min=0) = 0.8 "Damping ratio";
  parameter Real tau_m(quantity="Time", unit="s", min=0) = 0.002 "Pure delay of the response";
  input Real command(quantity="Length", unit="m", start=0) "Commanded position of the rod tip";
  output Real position(quantity="Length", unit="m", start=0, fixed=true) "Position of the rod tip";
  output Real velocity(quantity="Velocity", unit="m/s", start=0, fixed=true) "Velocity of the rod tip";
protected
  Real delayed_command(quantity="Length", unit="m") "Command that reaches the servo now";
equation
  // The delay stands before the servo, not after it: the two orders are equivalent for a linear
  // servo, and some tools mishandle a delay directly on an output.
  delayed_command = delay(command, tau_m);
  der(position) = velocity;
  der(velocity) = omega_n^2*(delayed_command - position) - 2*xi_n*omega_n*velocity;
  annotation (Documentation(info="<html>
<p>G(s) = omega_n^2 exp(-tau_m s) / (s^2 + 2 xi_n omega_n s + omega_n^2).</p>
<p>The source prints the middle term of the denominator as 2 xi_n s; with omega_n in it the
polynomial is dimensionally consistent, and only so do its figures follow.</p>
</html>"));
end RobotResponse;
