within Drives;
model CascadeControl "Position control with a velocity loop inside"
  parameter Real position_gain(unit="1/s", min=0) = 100 "Velocity asked for, per position error";
  parameter Real velocity_gain(unit="V.s/m", min=0) = 100 "Voltage per velocity error";
  input Real reference(quantity="Length", unit="m", start=0) "Position asked for";
  input Real position(quantity="Length", unit="m", start=0) "Position measured";
  input Real velocity(quantity="Velocity", unit="m/s", start=0) "Velocity measured";
  output Real voltage(unit="V") "Command to the drive";
equation
  voltage = velocity_gain*(position_gain*(reference - position) - velocity);
  annotation (Documentation(info="<html>
<p>u = k_v (k_p (x_r - x) - x'). A law without memory: stepped at the sample time of the controller it stands
for, it acts as that one does, its command held in between.</p>
</html>"));
end CascadeControl;
