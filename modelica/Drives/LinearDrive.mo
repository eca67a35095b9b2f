within Drives;
model LinearDrive "Mass on a guide, moved by a drive, with viscous friction"
  parameter Real mass(quantity="Mass", unit="kg", min=0) = 100 "Moved mass, inertia of the drive included";
  parameter Real viscous_friction(unit="N.s/m", min=0) = 0 "Friction per velocity";
  parameter Real force_per_voltage(unit="N/V") = 30 "Gain of the drive";
  input Real voltage(unit="V", start=0) "Command to the drive";
  input Real load(quantity="Force", unit="N", start=0) "Further force on the mass";
  output Real position(quantity="Length", unit="m", start=0, fixed=true) "Position of the mass";
  output Real velocity(quantity="Velocity", unit="m/s", start=0, fixed=true) "Velocity of the mass";
equation
  der(position) = velocity;
  mass*der(velocity) = force_per_voltage*voltage + load - viscous_friction*velocity;
  assert(mass > 0, "mass is 0 kg; allowed: above 0 kg");
  annotation (Documentation(info="<html>
<p>m x'' + b x' = k u + F.</p>
</html>"));
end LinearDrive;
