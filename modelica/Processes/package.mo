within ;
package Processes "Tanks and their control"
  annotation (
    version="0.1.0",
    Documentation(info="<html>
<p>Components of process plants. Every variable carries its SI unit. The package needs no library, not even the
Modelica Standard Library.</p>
</html>"));
end Processes;
