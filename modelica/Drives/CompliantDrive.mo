within Drives;
model CompliantDrive "Drive that moves a load through a spring and a damper"
  parameter Real motor_mass(quantity="Mass", unit="kg", min=0) = 40 "Mass of the drive";
  parameter Real load_mass(quantity="Mass", unit="kg", min=0) = 60 "Mass of the load";
  parameter Real stiffness(unit="N/m", min=0) = 400000 "Of the coupling between both";
  parameter Real damping(unit="N.s/m", min=0) = 300 "Of the coupling between both";
  parameter Real viscous_friction(unit="N.s/m", min=0) = 200 "Friction per velocity of the drive";
  parameter Real force_per_voltage(unit="N/V") = 35 "Gain of the drive";
  input Real voltage(unit="V", start=0) "Command to the drive";
  input Real load(quantity="Force", unit="N", start=0) "Further force on the load";
  output Real motor_position(quantity="Length", unit="m", start=0, fixed=true) "Position of the drive";
  output Real motor_velocity(quantity="Velocity", unit="m/s", start=0, fixed=true) "Velocity of the drive";
  output Real load_position(quantity="Length", unit="m", start=0, fixed=true) "Position of the load";
  output Real load_velocity(quantity="Velocity", unit="m/s", start=0, fixed=true) "Velocity of the load";
protected
  Real coupling(quantity="Force", unit="N") "Force of the coupling on the load";
equation
  coupling = stiffness*(motor_position - load_position) + damping*(motor_velocity - load_velocity);
  der(motor_position) = motor_velocity;
  der(load_position) = load_velocity;
  motor_mass*der(motor_velocity) = force_per_voltage*voltage - viscous_friction*motor_velocity - coupling;
  load_mass*der(load_velocity) = coupling + load;
  assert(motor_mass > 0 and load_mass > 0, "a mass is 0 kg; allowed: above 0 kg");
  annotation (Documentation(info="<html>
<p>m_1 x_1'' = k_u u - b x_1' - F, m_2 x_2'' = F + F_load, F = k (x_1 - x_2) + d (x_1' - x_2').</p>
</html>"));
end CompliantDrive;
