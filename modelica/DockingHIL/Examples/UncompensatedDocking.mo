within DockingHIL.Examples;
model UncompensatedDocking "The uncompensated docking loop in one model: reference for the co-simulation"
  parameter Real mass(quantity="Mass", unit="kg", min=0) = 279.06976744186045
    "Effective mass m_s m_t/(m_s + m_t) of 300 kg and 4000 kg";
  DockingHIL.RobotResponse robot "Robot that moves the rod";
  DockingHIL.DockingContact contact "Rod between the frames";
  output Real position(quantity="Length", unit="m", start=0, fixed=true) "Position that the satellite dynamics ask for";
  output Real velocity(quantity="Velocity", unit="m/s", start=0.02, fixed=true) "Velocity that the satellite dynamics ask for; its start value is the approach speed";
  output Real force(quantity="Force", unit="N") "Contact force on the rod";
equation
  der(position) = velocity;
  mass*der(velocity) = force;
  robot.command = position;
  contact.position = robot.position;
  contact.velocity = robot.velocity;
  force = contact.force;
  annotation (experiment(StopTime=3, Interval=1e-4, Tolerance=1e-8), Documentation(info="<html>
<p>Fig. 3 of the source: the delay and the lag of the robot make each rebound faster than the
approach. Compare <code>velocity</code> and <code>force</code>.</p>
</html>"));
end UncompensatedDocking;
