within DockingHIL;
model LabSensor "ForceSensor with a tool in front of it, whose inertia it reads; absent when its mass is zero"
  parameter Real tau_s(quantity="Time", unit="s", min=0) = 0 "Pure measurement delay";
  parameter Real cutoff(quantity="Frequency", unit="Hz", min=0) = 0 "Cut-off frequency of the low-pass; 0 Hz: no low-pass";
  parameter Real resolution(quantity="Force", unit="N", min=0) = 0 "Step of the reading; 0 N: not rounded";
  parameter Real tool_mass(quantity="Mass", unit="kg") = 0 "Mass in front of the sensor";
  parameter Real start_velocity(quantity="Velocity", unit="m/s") = 0 "Velocity of the rod tip at the start";
  input Real force(quantity="Force", unit="N", start=0) "Contact force on the rod";
  input Real velocity(quantity="Velocity", unit="m/s", start=0) "Velocity of the rod tip, for the tool";
  output Real measured_force(quantity="Force", unit="N") "Reading of the sensor";
protected
  constant Real two_pi(unit="rad") = 6.283185307179586;
  Real delayed_force(quantity="Force", unit="N") "Force that reaches the filter now";
  Real filtered_force(quantity="Force", unit="N", start=0, fixed=true) "State of the low-pass";
  Real delayed_velocity(quantity="Velocity", unit="m/s") "Velocity that reaches the filter now";
  Real filtered_velocity(quantity="Velocity", unit="m/s", start=start_velocity, fixed=true) "The same behind the low-pass";
  Real rate(quantity="Acceleration", unit="m/s2") "Its rate: the acceleration behind the low-pass";
  Real analog_force(quantity="Force", unit="N") "Reading before rounding";
equation
  delayed_force = delay(force, tau_s);
  der(filtered_force) = two_pi*cutoff*(delayed_force - filtered_force);
  delayed_velocity = delay(velocity, tau_s);
  rate = two_pi*cutoff*(delayed_velocity - filtered_velocity);
  der(filtered_velocity) = rate;
  analog_force = (if cutoff > 0 then filtered_force else delayed_force) - tool_mass*rate;
  // noEvent: as in ForceSensor, rounding is a property of the reading, not of the motion.
  measured_force = noEvent(if resolution > 0 then resolution*floor(analog_force/resolution + 0.5) else analog_force);
  assert(cutoff > 0 or not (tool_mass > 0 or tool_mass < 0),
    "tool_mass without a low-pass; give a cutoff, from whose state the acceleration is taken");
  annotation (Documentation(info="<html>
<p>measured_force(t) = round(h * (force - tool_mass x'')(t - tau_s)), with h a first-order low-pass. The low-pass of
an acceleration is the rate of the low-pass of the velocity, so that nothing is differentiated.</p>
</html>"));
end LabSensor;
