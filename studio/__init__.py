"""What people look at: the pages of reports, and the studio, a local application in the browser."""
