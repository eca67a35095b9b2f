model Drive "A mass on a guide, moved by a motor through a screw"
  parameter Real mass(unit="kg", min=0) = 95.1 "All that moves, seen at the guide";
  parameter Real viscous_friction(unit="N.s/m", min=0) = 203.5 "Force per speed";
  parameter Real force_per_voltage(unit="N/V") = 35.1507 "Of amplifier, motor and screw";
  parameter Real offset(unit="N") = 0 "Constant force against the motion, as of an amplifier";
  input Real voltage(unit="V", start=0) "Command of the amplifier";
  output Real position(unit="m", start=0, fixed=true) "Of the mass";
  output Real velocity(unit="m/s", start=0, fixed=true) "Its speed";
equation
  der(position) = velocity;
  mass*der(velocity) = force_per_voltage*voltage - viscous_friction*velocity - offset;
end Drive;
