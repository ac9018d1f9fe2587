"""Problems of ``wbmpc bench``: the robots of the papers, and problems of the sizes of other toolboxes' examples."""
