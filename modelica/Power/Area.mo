within Power;
model Area "Machine, turbine and governor of an area, with its load-frequency control"
  parameter Real inertia(quantity="Time", unit="s", min=0) = 10 "M = 2 H";
  parameter Real load_damping(unit="1", min=0) = 1 "D: load per frequency deviation";
  parameter Real turbine_time(quantity="Time", unit="s", min=0) = 0.3 "Time constant of the turbine";
  parameter Real governor_time(quantity="Time", unit="s", min=0) = 0.1 "Time constant of the governor";
  parameter Real droop(unit="1", min=0) = 0.05 "R: frequency deviation per power";
  parameter Real bias(unit="1", min=0) = 21 "B: of the frequency deviation in the control error";
  parameter Real integral_gain(unit="1/s", min=0) = 0.2 "K_I: of the control error";
  parameter Real tie(unit="1", min=0) = 0 "Exchanged power per difference of the angles";
  parameter Real nominal_frequency(quantity="Frequency", unit="Hz", min=0) = 50 "Of the grid";
  input Real setpoint(unit="1", start=0) "Power asked for by the load-frequency control, as it arrives";
  input Real load(unit="1", start=0) "Change of the load";
  input Real other_angle(unit="rad", start=0) "Angle of the other area";
  output Real angle(unit="rad", start=0, fixed=true) "Angle of this area";
  output Real deviation(unit="1", start=0, fixed=true) "Frequency deviation";
  output Real command(unit="1", start=0, fixed=true) "Power that the load-frequency control asks for";
  output Real exchange(unit="1") "Power that flows to the other area";
  Real mechanical(unit="1", start=0, fixed=true) "Power of the turbine";
  Real valve(unit="1", start=0, fixed=true) "Position of the valve";
protected
  constant Real pi(unit="1") = 3.141592653589793;
equation
  exchange = tie*(angle - other_angle);
  der(angle) = 2*pi*nominal_frequency*deviation;
  inertia*der(deviation) = mechanical - load - load_damping*deviation - exchange;
  turbine_time*der(mechanical) = valve - mechanical;
  governor_time*der(valve) = setpoint - deviation/droop - valve;
  der(command) = -integral_gain*(bias*deviation + exchange);
  assert(inertia > 0 and turbine_time > 0 and governor_time > 0, "a time constant is 0 s; allowed: above 0 s");
  assert(droop > 0, "droop is 0; allowed: above 0");
  annotation (Documentation(info="<html>
<p>Deviations per unit: M f' = P_m - P_l - D f - P_t, T_t P_m' = P_v - P_m, T_g P_v' = P_c - f/R - P_v,
P_t = T (a - a_o), a' = 2 pi f_0 f, and the control error B f + P_t, integrated.</p>
</html>"));
end Area;
