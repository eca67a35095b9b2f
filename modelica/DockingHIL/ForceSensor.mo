within DockingHIL;
model ForceSensor "Force sensor: pure delay, first-order low-pass, resolution"
  parameter Real tau_s(quantity="Time", unit="s", min=0) = 0 "Pure measurement delay";
  parameter Real cutoff(quantity="Frequency", unit="Hz", min=0) = 0 "Cut-off frequency of the low-pass; 0 Hz: no low-pass";
  parameter Real resolution(quantity="Force", unit="N", min=0) = 0 "Step of the reading; 0 N: not rounded";
  input Real force(quantity="Force", unit="N", start=0) "Contact force on the rod";
  output Real measured_force(quantity="Force", unit="N") "Reading of the sensor";
protected
  constant Real two_pi(unit="rad") = 6.283185307179586;
  Real delayed_force(quantity="Force", unit="N") "Force that reaches the filter now";
  Real filtered_force(quantity="Force", unit="N", start=0, fixed=true) "State of the low-pass";
  Real analog_force(quantity="Force", unit="N") "Reading before rounding";
equation
  delayed_force = delay(force, tau_s);
  der(filtered_force) = two_pi*cutoff*(delayed_force - filtered_force);
  analog_force = if cutoff > 0 then filtered_force else delayed_force;
  // noEvent: rounding is a property of the reading, not of the motion; an event at every step of
  // the resolution would stop the integrator thousands of times for nothing.
  measured_force = noEvent(if resolution > 0 then resolution*floor(analog_force/resolution + 0.5) else analog_force);
  annotation (Documentation(info="<html>
<p>measured_force(t) = round(h * force(t - tau_s)), with h a first-order low-pass of the given
cut-off frequency. Each part is absent when its parameter is zero.</p>
</html>"));
end ForceSensor;
