within DockingHIL;
package Examples "Complete systems of the components"
end Examples;
